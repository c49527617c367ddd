"""The camera's depth against the board's calibrated plane, and its correction.

A stereo camera measures disparity, so an error of scale and of a constant number of pixels both
turn into 1/z = a / z_measured + b: with it a bias of 5 mm falls to hundredths, with scale alone
to one millimetre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from calibration.projection import project
from calibration.target import CharucoTarget
from tdpg_deploy.depth_model import DepthModel
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

INSIDE = 0.08  # of a white square: strips between marker and edge, away from both
LEAST_SAMPLES, LEAST_RANGE = 30, 0.08  # samples, and metres of depth, to fit two numbers
WORST_RESIDUAL = 4e-3  # m rms beside the model: more is no inverse-affine error


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthSamples:
    """expected, measured: (n,) metres at places in white squares; nan where not measured."""

    expected: Array
    measured: Array


@dataclass(frozen=True, kw_only=True)
class DepthQuality:
    """offset: mean of measured minus expected (m). rms: about that mean (m). fill: share of
    places with a measurement. left: mean that the model leaves (m)."""

    offset: float
    rms: float
    fill: float
    left: float


def sample_depth(
    depth: npt.NDArray[np.float32],
    target: CharucoTarget,
    X_camera_board: Transform,
    lens: Intrinsics,
    scale: float = 1.0,
) -> DepthSamples:
    """Median depth inside each white square, in a ring around its marker.

    depth: (H, W) metres, aligned to the colour camera `lens`. scale: printed over nominal size.
    """
    offsets = np.linspace(-0.5 + INSIDE / 2, 0.5 - INSIDE / 2, 9) * target.square
    x, y = np.meshgrid(offsets, offsets)
    margin = (target.marker + target.square) / 4
    ring = np.maximum(np.abs(x), np.abs(y)) >= margin
    inside = np.stack([x[ring], y[ring]], axis=1)
    p_board = target.white_squares()[:, None] + inside
    p_camera = X_camera_board @ (scale * np.pad(p_board, ((0, 0), (0, 0), (0, 1))))
    pixels = project(p_camera, lens)[0]
    height, width = depth.shape
    u, v = np.round(pixels[..., 0]).astype(int), np.round(pixels[..., 1]).astype(int)
    seen = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    measured = np.where(seen, depth[v.clip(0, height - 1), u.clip(0, width - 1)], np.nan)
    # Ratios, so that a tilted square does not blur its own median.
    ratio = measured / p_camera[..., 2]
    middle = p_camera[..., 2].mean(axis=1)
    enough = np.isfinite(ratio).mean(axis=1) > 0.5
    medians = np.full(len(ratio), np.nan)
    if enough.any():
        medians[enough] = np.nanmedian(ratio[enough], axis=1)
    return DepthSamples(expected=middle, measured=medians * middle)


def fit_depth(samples: Sequence[DepthSamples]) -> tuple[DepthModel, DepthQuality]:
    """Robust fit over all views. Raises CalibrationError when depth cannot be corrected."""
    expected = np.concatenate([s.expected for s in samples])
    measured = np.concatenate([s.measured for s in samples])
    known = np.isfinite(measured) & (measured > 0)
    fill = float(known.mean()) if len(known) else 0.0
    expected, measured = expected[known], measured[known]
    if len(measured) < LEAST_SAMPLES:
        raise CalibrationError(
            f"depth is known in {len(measured)} white squares, {LEAST_SAMPLES} are needed: check "
            "that the depth stream is on and aligned to colour, and that the board does not shine"
        )
    offset = measured - expected
    if np.ptp(expected) < LEAST_RANGE:
        raise CalibrationError(
            f"the board was seen within {np.ptp(expected) * 1e3:.0f} mm of depth; add views until "
            f"{LEAST_RANGE * 1e3:.0f} mm or more are covered"
        )
    weight = expected**2  # depth noise grows with the square of distance

    def residuals(ab: Array) -> Array:
        return np.asarray((1 / (ab[0] / measured + ab[1]) - expected) / weight)

    spread = np.median(np.abs(residuals(np.array([1.0, 0.0])))) + 1e-6
    first = least_squares(residuals, [1.0, 0.0], loss="cauchy", f_scale=spread)
    spread = 1.5 * np.median(np.abs(residuals(first.x))) + 1e-6
    found = least_squares(residuals, first.x, loss="soft_l1", f_scale=2 * spread)
    model = DepthModel(a=float(found.x[0]), b=float(found.x[1]))
    left = model.correct(measured.astype(np.float32)) - expected
    rms = float(np.sqrt(np.median(left**2)) * 1.48)
    if rms > WORST_RESIDUAL or not 0.9 < model.a < 1.1:
        raise CalibrationError(
            f"depth differs from the board's plane by {rms * 1e3:.1f} mm rms beside any "
            f"inverse-affine error (a = {model.a:.3f}): depth may not be aligned to colour, or the "
            "camera needs its own calibration"
        )
    quality = DepthQuality(
        offset=float(np.median(offset)),
        rms=rms,
        fill=fill,
        left=float(np.median(left)),
    )
    return model, quality
