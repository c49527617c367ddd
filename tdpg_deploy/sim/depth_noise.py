"""What a D435 makes of true depth. Pure: the generator is passed in.

The depth camera matches blocks of pixels between two imagers 50 mm apart. So depth errs by a
share of a pixel of disparity, which grows with z squared in metres; what only one imager sees is
unknown; edges are ragged; and there are holes where a surface is steep or too dark to match.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from tdpg_deploy.compiled import compiled
from tdpg_deploy.hal import Intrinsics

Depth = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class StereoNoise:
    """Of a D435 at 848 x 480, where its depth is best. Pixels are those of its imagers.

    baseline: m. focal: pixels (data sheet: depth field of view 87 degrees).
    disparity_sd: pixels, matching error on a textured wall. disparity_step: of the chip's output.
    correlation: pixels over which errors are alike, from the size of the matched block.
    edge_jitter: sd in pixels of where an edge is seen. dark: luminance (0..255) below which holes
    appear, up to `dark_holes` of the surface. grazing: slope dz/dx (pixels of disparity a pixel)
    above which nothing is matched.
    """

    baseline: float = 0.050
    focal: float = 425.0
    disparity_sd: float = 0.08
    disparity_step: float = 1 / 32
    correlation: float = 1.2
    edge_jitter: float = 0.7
    dark: float = 50.0
    dark_holes: float = 0.25
    lost: float = 0.002
    grazing: float = 0.35


D435 = StereoNoise()


def with_stereo_noise(
    depth: Depth,
    color: npt.NDArray[np.uint8],
    intrinsics: Intrinsics,
    rng: np.random.Generator,
    noise: StereoNoise = D435,
) -> Depth:
    """Depth (H, W) m as the camera would deliver it, aligned to the colour image; nan where
    unknown. The imagers are taken to stand where the colour camera does."""
    pitch = intrinsics.fx / noise.focal  # pixels of the picture in one of the imagers'
    shape = depth.shape
    coarse = int(np.ceil(shape[0] / pitch)), int(np.ceil(shape[1] / pitch))
    error = _field(rng, coarse, shape, noise.correlation)
    jitter_row = _field(rng, coarse, shape, 0.5) * np.float32(noise.edge_jitter * pitch)
    jitter_col = _field(rng, coarse, shape, 0.5) * np.float32(noise.edge_jitter * pitch)
    blotches = _field(rng, coarse, shape, 2.0)
    luminance = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    out = np.empty(shape, np.float32)
    _corrupt(
        depth,
        luminance,
        error,
        jitter_row,
        jitter_col,
        blotches,
        out,
        intrinsics.fx,
        noise.baseline,
        pitch,
        noise.disparity_sd,
        noise.disparity_step,
        noise.dark,
        _normal_quantile(noise.dark_holes),
        _normal_quantile(noise.lost),
        noise.grazing,
    )
    return out


def _field(
    rng: np.random.Generator, coarse: tuple[int, int], shape: tuple[int, ...], correlation: float
) -> Depth:
    """Normal noise of unit variance (H, W), alike over `correlation` coarse pixels."""
    white = rng.standard_normal(coarse, np.float32)
    smooth = cv2.GaussianBlur(white, (0, 0), correlation)
    smooth *= np.float32(2 * np.sqrt(np.pi) * correlation)  # the sd of a blurred white field
    field = cv2.resize(smooth, shape[::-1], interpolation=cv2.INTER_NEAREST)
    return field.astype(np.float32, copy=False)


def _normal_quantile(share: float) -> float:
    """The value below which a normal variable lies with this probability."""
    from scipy.special import ndtri

    return float(ndtri(share))


@compiled
def _corrupt(
    depth: Depth,
    luminance: npt.NDArray[np.uint8],
    error: Depth,
    jitter_row: Depth,
    jitter_col: Depth,
    blotches: Depth,
    out: Depth,
    focal: float,
    baseline: float,
    pitch: float,
    disparity_sd: float,
    disparity_step: float,
    dark: float,
    dark_quantile: float,
    lost_quantile: float,
    grazing: float,
) -> None:
    """In pixels of the picture, `pitch` of which are one of the imagers'."""
    rows, cols = depth.shape
    scale = focal * baseline
    for row in range(rows):
        leftmost = np.inf  # in the other imager, of all that was passed, from the right
        for col in range(cols - 1, -1, -1):
            out[row, col] = np.nan
            true = depth[row, col]
            if not true > 0:
                continue
            place = col - scale / true
            hidden = place >= leftmost
            leftmost = min(leftmost, place)
            if hidden or blotches[row, col] < lost_quantile:
                continue
            if luminance[row, col] < dark and blotches[row, col] < dark_quantile:
                continue
            if _slope(depth, row, col, scale) > grazing:
                continue
            from_row = min(max(row + int(np.rint(jitter_row[row, col])), 0), rows - 1)
            from_col = min(max(col + int(np.rint(jitter_col[row, col])), 0), cols - 1)
            seen = depth[from_row, from_col]
            if not seen > 0:
                continue
            disparity = scale / seen / pitch + disparity_sd * error[row, col]
            steps = np.rint(disparity / disparity_step)
            if steps > 0:
                out[row, col] = scale / (pitch * steps * disparity_step)


@compiled
def _slope(depth: Depth, row: int, col: int, scale: float) -> float:
    """Change of disparity (pixels a pixel) across the surface at a pixel: the smaller one of
    both sides, so that the border of a surface is not taken for a steep one."""
    rows, cols = depth.shape
    if row == 0 or col == 0 or row == rows - 1 or col == cols - 1:
        return 0.0
    here = scale / depth[row, col]
    across = min(abs(scale / depth[row, col - 1] - here), abs(scale / depth[row, col + 1] - here))
    down = min(abs(scale / depth[row - 1, col] - here), abs(scale / depth[row + 1, col] - here))
    steepest = max(across, down)
    return steepest if steepest == steepest else 0.0
