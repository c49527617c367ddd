"""Does the calibration predict what it has not seen?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.closed_form import board_pose
from calibration.projection import project
from calibration.refine import Freedom
from calibration.solve import HandEye, solve
from calibration.views import View
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

FOLDS = 5


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Views predicted by a calibration from the other views.

    rms_px: all held-out corners. position: metres, rms over the views between where the board was
    seen to be, by its own corners, and where the calibration said. angle: radians, the same.
    """

    rms_px: float
    position: float
    angle: float


@dataclass(frozen=True, kw_only=True)
class Jackknife:
    """Standard deviations (m, rad) from leaving out each fifth of the views, free of any model
    of the noise, and the largest move that one fifth makes."""

    position_sd: float
    rotation_sd: float
    largest_move: float


def hold_out(
    found: HandEye, views: Sequence[View], board_corners: Array, lens: Intrinsics
) -> tuple[HeldOut, Jackknife]:
    """Solve without each fifth of the views used, with the same freedom. lens: nominal."""
    names = {view.name for view in found.views if view.used}
    used = [view for view in views if view.name in names]
    freedom = Freedom(lens=found.lens_refined, scale=found.scale_refined)
    squares, distances, angles, poses = [], [], [], []
    for k in range(FOLDS):
        kept = [view for i, view in enumerate(used) if i % FOLDS != k]
        try:
            part = solve(kept, board_corners, lens, found.mounting, freedoms=[freedom])
        except CalibrationError as error:
            raise CalibrationError(f"too few views to hold some out: {error}") from error
        poses.append(part.X_parent_camera)
        corners = part.board_scale * board_corners
        for view in used[k::FOLDS]:
            X_camera_board = predicted_board(part, view)
            seen = board_pose(view, corners, part.intrinsics)
            residual = predict(part, view, board_corners) - view.corners
            squares.append((residual**2).sum(axis=1))
            middle = corners.mean(axis=0)
            distances.append(np.linalg.norm(X_camera_board @ middle - seen @ middle))
            angles.append(X_camera_board.distance(seen)[1])
    held_out = HeldOut(
        rms_px=float(np.sqrt(np.concatenate(squares).mean())),
        position=float(np.sqrt(np.mean(np.square(distances)))),
        angle=float(np.sqrt(np.mean(np.square(angles)))),
    )
    return held_out, _jackknife(poses, found.X_parent_camera)


def predicted_board(found: HandEye, view: View) -> Transform:
    """X_camera_board where the arm's pose says it is."""
    arm = view.X_parents(found.mounting)
    return found.X_parent_camera.inverse() @ arm @ found.X_parent_board


def predict(found: HandEye, view: View, board_corners: Array) -> Array:
    """(n, 2) px of the view's corners."""
    points = found.board_scale * board_corners[view.ids]
    return project(predicted_board(found, view) @ points, found.intrinsics)[0]


def _jackknife(poses: Sequence[Transform], whole: Transform) -> Jackknife:
    places = np.stack([X.translation for X in poses])
    turns = np.stack([(X.rotation * whole.rotation.inv()).as_rotvec() for X in poses])
    factor = (FOLDS - 1) / FOLDS  # delete-a-group jackknife

    def deviation(values: Array) -> float:
        return float(np.sqrt(factor * ((values - values.mean(axis=0)) ** 2).sum()))

    return Jackknife(
        position_sd=deviation(places),
        rotation_sd=deviation(turns),
        largest_move=float(np.linalg.norm(places - whole.translation, axis=1).max()),
    )


def workspace_deviation(covariance: Array, X_parent_camera: Transform, points: Array) -> Array:
    """(...) metres: standard deviation of where camera points at (..., 3) land in the parent.

    covariance: (6, 6) as in HandEye. Root of the summed variances of the three axes.
    """
    arm = points - X_parent_camera.translation
    J = np.zeros((*arm.shape[:-1], 3, 6))
    J[..., :3] = np.eye(3)
    x, y, z = np.moveaxis(arm, -1, 0)
    # error = v + w x arm
    J[..., 0, 4], J[..., 0, 5] = z, -y
    J[..., 1, 3], J[..., 1, 5] = -z, x
    J[..., 2, 3], J[..., 2, 4] = y, -x
    return np.asarray(np.sqrt(np.einsum("...ij,jk,...ik->...", J, covariance, J)))
