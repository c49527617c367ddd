"""What a D435 makes of true depth. Pure: the generator is passed in.

The depth camera matches blocks of pixels between two imagers 50 mm apart. So depth errs by a
share of a pixel of disparity, which in metres grows with z squared:
sigma_z = z^2 * sigma_disparity / (focal * baseline). What only one imager sees is unknown; edges
are ragged and smeared; and there are holes where a surface is steep or too dark to match.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from tdpg_deploy.compiled import compiled
from tdpg_deploy.hal import Intrinsics

Depth = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class StereoNoise:
    """Of a D435 at 848 x 480, where its depth is best. Pixels are those of its imagers.

    baseline (m), focal (px) and nearest (m): D400 series data sheet (50 mm, field of view 87
    degrees, Min-Z). disparity_sd (px): on a textured wall, as the camera's makers advise
    (librealsense #3904). disparity_step (px): of the chip's output, 1/32 ("Subpixel Linearity
    Improvement for Intel RealSense D400"). What follows has no published figure.
    correlation (px): sd of the blur that makes errors alike, from the size of the matched block.
    edge_jitter (px): sd of where an edge is seen. smeared: share of the pixels at such an edge
    that show a depth in between. lost: share of pixels that are holes anywhere. dark: luminance
    (0..255) below which a share `dark_holes` is lost. grazing (px of disparity per px): slope
    above which nothing is matched.
    """

    baseline: float = 0.050
    focal: float = 425.0
    nearest: float = 0.20
    disparity_sd: float = 0.08
    disparity_step: float = 1 / 32
    correlation: float = 1.2
    edge_jitter: float = 0.7
    smeared: float = 0.3
    lost: float = 0.002
    dark: float = 50.0
    dark_holes: float = 0.25
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
    rows, cols = (int(np.ceil(size / pitch)) for size in depth.shape)
    fields = np.stack(
        [
            _field(rng, (rows, cols), noise.correlation) * (noise.disparity_sd * pitch),
            _field(rng, (rows, cols), 0.5) * (noise.edge_jitter * pitch),
            _field(rng, (rows, cols), 0.5) * (noise.edge_jitter * pitch),
            _field(rng, (rows, cols), 2.0),
        ]
    ).astype(np.float32)
    scale = intrinsics.fx * noise.baseline
    with np.errstate(divide="ignore"):
        true = np.float32(scale) / depth
    rules = _Rules(
        pitch=pitch,
        step=noise.disparity_step * pitch,
        largest=scale / noise.nearest,
        grazing=noise.grazing,
        dark=noise.dark,
        lost_below=float(ndtri(noise.lost)),
        dark_below=float(ndtri(noise.dark_holes)),
        smeared_above=float(-ndtri(noise.smeared)),
    )
    luminance = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)
    disparity = _match(true, luminance, fields, rules)
    return np.float32(scale) / disparity


def _field(rng: np.random.Generator, shape: tuple[int, int], blur: float) -> Depth:
    """(H, W) normal noise of unit variance, white noise blurred with a sd of `blur` pixels."""
    reach = int(np.ceil(3 * blur))
    kernel = np.exp(-((np.arange(-reach, reach + 1) / blur) ** 2) / 2)
    kernel /= np.linalg.norm(kernel)
    white = rng.standard_normal((shape[0] + 2 * reach, shape[1] + 2 * reach), np.float32)
    field = cv2.sepFilter2D(white, -1, kernel, kernel)[reach:-reach, reach:-reach]
    return np.asarray(field, np.float32)


class _Rules(NamedTuple):
    """StereoNoise for one picture: lengths in its pixels, `pitch` of which are one of the imagers',
    and shares as the values of the blotches beyond which they lie."""

    pitch: float
    step: float
    largest: float
    grazing: float
    dark: float
    lost_below: float
    dark_below: float
    smeared_above: float


@compiled
def _match(true: Depth, luminance: npt.NDArray[np.uint8], fields: Depth, rules: _Rules) -> Depth:
    """True disparity -> matched disparity, both in pixels of the picture, nan where unmatched.

    fields: error of disparity, jitter of rows and columns, blotches, for each pixel of the
    imagers, which is `pitch` pixels of the picture wide.
    """
    rows, cols = true.shape
    matched = np.full((rows, cols), np.nan, np.float32)
    for row in range(rows):
        error, jitter_row, jitter_col, blotches = fields[:, int(row / rules.pitch)]
        leftmost = np.inf  # in the other imager, of all that was passed, from the right
        for col in range(cols - 1, -1, -1):
            if not 0 < true[row, col] < rules.largest:  # so for nan
                continue
            place = col - true[row, col]
            hidden = place >= leftmost
            leftmost = min(leftmost, place)
            imager_col = int(col / rules.pitch)
            blotch = blotches[imager_col]
            if hidden or blotch < rules.lost_below:
                continue
            if luminance[row, col] < rules.dark and blotch < rules.dark_below:
                continue
            if _slope(true, row, col) > rules.grazing:
                continue
            down = int(np.rint(jitter_row[imager_col]))
            right = int(np.rint(jitter_col[imager_col]))
            seen = _at(true, row + down, col + right)
            if blotch > rules.smeared_above:
                share = min(blotch - rules.smeared_above, 1) / 2
                seen += share * (_at(true, row - down, col - right) - seen)
            steps = np.rint((seen + error[imager_col]) / rules.step)
            if steps > 0:  # not so for nan
                matched[row, col] = steps * rules.step
    return matched


@compiled
def _at(image: Depth, row: int, col: int) -> float:
    """Value at a pixel, or at the border nearest to it."""
    rows, cols = image.shape
    return float(image[min(max(row, 0), rows - 1), min(max(col, 0), cols - 1)])


@compiled
def _slope(disparity: Depth, row: int, col: int) -> float:
    """Change of disparity (pixels a pixel) across the surface at a pixel: the smaller one of
    both sides, so that the border of a surface is not taken for a steep one."""
    here = disparity[row, col]
    across = min(abs(_at(disparity, row, col - 1) - here), abs(_at(disparity, row, col + 1) - here))
    down = min(abs(_at(disparity, row - 1, col) - here), abs(_at(disparity, row + 1, col) - here))
    return float(max(across, down))
