"""From views to the camera's pose, its covariance, and a verdict on every view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from calibration import closed_form, diagnosis
from calibration.projection import BOARD, CAMERA, Estimate, Observations, linearise
from calibration.refine import (
    Fit,
    Freedom,
    Noise,
    chi_squares,
    fit,
    split,
)
from calibration.views import Mounting, PoseNoise, View
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

FOLDS = 5
MARGIN = 1.5
WORTH = 20.0  # chi-square that held-out views must gain before lens or scale is set free
GATE_PIXEL_NOISE = 0.1  # px; far or oblique views have more than the median one, and are good
LEAST_PIXEL_NOISE = 0.02  # px; better corners have not been seen, nor a smaller error be true


@dataclass(frozen=True, kw_only=True)
class ViewResult:
    """How one view took part.

    rms: pixels between predicted and seen corners. ratio: chi-square over its mean, 1 is usual.
    """

    name: str
    used: bool
    rms: float
    ratio: float


@dataclass(frozen=True, kw_only=True, eq=False)
class HandEye:
    """A calibration.

    X_parent_camera: X_base_camera for eye-to-hand, X_tool_camera for eye-in-hand.
    X_parent_board: X_tool_board for eye-to-hand, X_base_board for eye-in-hand.
    covariance: (6, 6) of X_parent_camera, of x, y, z (m), then of the rotation vector (rad) that
        turns the true camera into the estimated one, along the axes of the parent frame.
    board_covariance: the same of X_parent_board.
    intrinsics: those used; they differ from nominal if lens_refined.
    board_scale: printed over nominal size; 1 unless scale_refined.
    pixel_noise: px. pose_noise: of the arm, as estimated.
    """

    mounting: Mounting
    X_parent_camera: Transform
    X_parent_board: Transform
    covariance: Array
    board_covariance: Array
    intrinsics: Intrinsics
    lens_refined: bool
    board_scale: float
    scale_refined: bool
    pixel_noise: float
    pose_noise: PoseNoise
    views: tuple[ViewResult, ...]
    notes: tuple[str, ...]

    @property
    def X_base_camera(self) -> Transform:
        if self.mounting is not Mounting.EYE_TO_HAND:
            raise CalibrationError(
                "an eye-in-hand calibration has no X_base_camera; "
                "multiply X_base_tool @ X_tool_camera for each picture"
            )
        return self.X_parent_camera

    @property
    def X_tool_camera(self) -> Transform:
        if self.mounting is not Mounting.EYE_IN_HAND:
            raise CalibrationError("an eye-to-hand calibration has no X_tool_camera")
        return self.X_parent_camera

    @property
    def standard_deviations(self) -> tuple[float, float]:
        """Of the camera's place (m) and attitude (rad), root of the summed variances."""
        variances = np.diag(self.covariance)
        return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:].sum()))

    @property
    def rms(self) -> float:
        """Pixels, over the views used."""
        return float(np.sqrt(np.mean([view.rms**2 for view in self.views if view.used])))


def solve(
    views: Sequence[View],
    board_corners: Array,
    intrinsics: Intrinsics,
    mounting: Mounting,
    *,
    pose_noise: PoseNoise | None = None,
    freedoms: Sequence[Freedom] | None = None,
) -> HandEye:
    """board_corners: (n, 3) metres, nominal, in the board's frame, by corner id.

    freedoms: models to choose from by held-out views; all four when absent.
    Raises CalibrationError naming what is wrong with the views, or what to add.
    """
    diagnosis.check_views(views, len(board_corners))
    views, notes = diagnosis.without_duplicates(views)
    diagnosis.check_enough(views)
    X_camera_boards = [closed_form.board_pose(view, board_corners, intrinsics) for view in views]
    begin = diagnosis.consistent_start(views, X_camera_boards, mounting)
    nominal = Estimate(
        X_parent_camera=begin.X_parent_camera,
        X_parent_board=begin.X_parent_board,
        intrinsics=intrinsics,
    )
    seen = Observations.of(views, board_corners, mounting)
    prior_noise = pose_noise or PoseNoise()
    choices = (
        list(freedoms)
        if freedoms is not None
        else [Freedom(lens=lens, scale=scale) for lens in (False, True) for scale in (False, True)]
    )

    widest = Freedom(lens=any(f.lens for f in choices), scale=any(f.scale for f in choices))
    wide, noise, used = _gated(nominal, nominal, seen, prior_noise, widest)
    diagnosis.check_spread([view for view, use in zip(views, used, strict=True) if use])
    freedom = _choose(choices, wide.estimate, nominal, seen.take(used), noise)
    final, noise, used = _gated(wide.estimate, nominal, seen, prior_noise, freedom, used=used)
    diagnosis.check_outcome(views, used, final.estimate, intrinsics)
    return _result(final, noise, used, views, seen, mounting, prior_noise, notes)


def _gated(
    begin: Estimate,
    nominal: Estimate,
    seen: Observations,
    prior_noise: PoseNoise,
    freedom: Freedom,
    *,
    used: npt.NDArray[np.bool_] | None = None,
) -> tuple[Fit, Noise, npt.NDArray[np.bool_]]:
    """Fit, drop views that do not fit, and fit the rest, until none changes sides.

    Starts robustly from all views when `used` is not known.
    """
    noise = Noise(pixel=0.5, pose=prior_noise.variances())
    if used is None:
        begin = fit(begin, nominal, seen, noise, freedom, robust=True).estimate
        used = _good(begin, seen, _measured(begin, seen, prior_noise, robust=True))
    for _ in range(5):
        diagnosis.check_share(used)
        begin = fit(begin, nominal, seen.take(used), noise, freedom).estimate
        noise = _measured(begin, seen.take(used), prior_noise, robust=False)
        now = _good(begin, seen, noise)
        if (now == used).all():
            break
        used = now
    return fit(begin, nominal, seen.take(used), noise, freedom), noise, used


def _measured(estimate: Estimate, seen: Observations, prior: PoseNoise, *, robust: bool) -> Noise:
    parts = split(estimate, seen)
    pixel = max(parts.pixel_noise(), LEAST_PIXEL_NOISE)
    noise = Noise(pixel=pixel, pose=prior.variances())
    factor = parts.pose_noise_factor(noise, robust=robust)
    return Noise(pixel=pixel, pose=factor**2 * noise.pose)


def _good(estimate: Estimate, seen: Observations, noise: Noise) -> npt.NDArray[np.bool_]:
    """(V,) views whose corners fit the board and whose pose fits the rest.

    One good view in 10,000 fails, with a margin for noise that is not quite Gaussian.
    """
    parts = split(estimate, seen)
    noise = replace(noise, pixel=max(noise.pixel, GATE_PIXEL_NOISE))
    freedom = parts.counts - 6
    corners = parts.corner_ratio(noise.pixel) < MARGIN * chi2.ppf(1 - 1e-4, freedom) / freedom
    pose = parts.pose_chi2(noise) < MARGIN * chi2.ppf(1 - 1e-4, 6)
    return np.asarray(corners & pose)


def _choose(
    choices: Sequence[Freedom],
    begin: Estimate,
    nominal: Estimate,
    seen: Observations,
    noise: Noise,
) -> Freedom:
    """The model that predicts held-out views best; more freedom has to earn it."""
    if len(choices) == 1:
        return choices[0]
    fold = np.arange(len(seen)) % FOLDS

    def held_out(freedom: Freedom) -> float:
        total = 0.0
        for k in range(FOLDS):
            kept = fit(begin, nominal, seen.take(fold != k), noise, freedom)
            total += float(chi_squares(kept.estimate, seen.take(fold == k), noise).sum())
        return total + WORTH * (freedom.lens + freedom.scale)

    return min(choices, key=held_out)


def _result(
    final: Fit,
    noise: Noise,
    used: npt.NDArray[np.bool_],
    views: Sequence[View],
    seen: Observations,
    mounting: Mounting,
    prior_noise: PoseNoise,
    notes: Sequence[str],
) -> HandEye:
    estimate = final.estimate
    residuals = linearise(estimate, seen).residuals
    rms = np.sqrt((residuals**2).sum(axis=1) / (seen.counts / 2))
    ratios = chi_squares(estimate, seen, noise) / seen.counts
    factor = float(np.sqrt(noise.pose[3])) / prior_noise.translation
    pose_noise = PoseNoise(
        translation=factor * prior_noise.translation, rotation=factor * prior_noise.rotation
    )
    covariance = final.covariance()
    return HandEye(
        mounting=mounting,
        X_parent_camera=estimate.X_parent_camera,
        X_parent_board=estimate.X_parent_board,
        covariance=_in_parent(covariance[CAMERA, CAMERA], estimate.X_parent_camera),
        board_covariance=_in_parent(covariance[BOARD, BOARD], estimate.X_parent_board),
        intrinsics=estimate.intrinsics,
        lens_refined=final.freedom.lens,
        board_scale=estimate.scale,
        scale_refined=final.freedom.scale,
        pixel_noise=noise.pixel,
        pose_noise=pose_noise,
        views=tuple(
            ViewResult(name=view.name, used=bool(u), rms=float(e), ratio=float(q))
            for view, u, e, q in zip(views, used, rms, ratios, strict=True)
        ),
        notes=(*notes, *diagnosis.notes_on_arm(pose_noise)),
    )


def _in_parent(moved: Array, X_parent: Transform) -> Array:
    """Covariance of (w, v) along the moved frame's axes -> of (v, w) along the parent's."""
    R = X_parent.rotation.as_matrix()
    turn = np.zeros((6, 6))
    turn[:3, 3:] = turn[3:, :3] = R
    return np.asarray(turn @ moved @ turn.T, np.float64)
