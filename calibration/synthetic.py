"""Views with a truth that only this module knows, for tests and benchmarks.

Pixels come from OpenCV's projection, not from `calibration.projection`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from calibration.views import Mounting, PoseNoise, View
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

D435_720P = Intrinsics(width=1280, height=720, fx=915.0, fy=914.0, cx=643.0, cy=361.0)
# m from camera to board. The spread decides how hard a set of views is: with these, 25 views at
# 0.25 px and the arm's usual noise let no estimator place the camera better than 0.098 mm (fixed)
# and 0.070 mm (on the tool), medians. An arm that brings the board closer has it easier.
DEPTHS = {Mounting.EYE_TO_HAND: (0.62, 0.90), Mounting.EYE_IN_HAND: (0.36, 0.54)}
LEAST_SEEN = 0.7  # of the board's corners


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """Both constant poses, and the lens and board that make the pictures.

    board_corners: (n, 3) metres as printed, by corner id.
    """

    mounting: Mounting
    X_parent_camera: Transform
    X_parent_board: Transform
    intrinsics: Intrinsics
    board_corners: Array


def make_truth(
    mounting: Mounting,
    board_corners: Array,
    rng: np.random.Generator,
    intrinsics: Intrinsics = D435_720P,
) -> Truth:
    """A camera over a table 0.5 m before the base, or beside the gripper; jittered by `rng`."""
    if mounting is Mounting.EYE_TO_HAND:
        # 0.76 m above the middle of the work, tilted by 20 degrees, looking back at the arm.
        camera = _pose([0.76, 0.0, 0.56], "ZX", [90, -160])
        board = _pose([-0.10, -0.10, 0.05], "YZ", [70, 20])  # gripped by its edge
    else:
        camera = _pose([0.0, -0.08, -0.10], "X", [10])
        board = _pose([0.40, 0.10, -0.15], "X", [180])  # face up on the table
    return Truth(
        mounting=mounting,
        X_parent_camera=camera @ _random_pose(rng, 0.02, 0.05),
        X_parent_board=board @ _random_pose(rng, 0.02, 0.05),
        intrinsics=intrinsics,
        board_corners=board_corners,
    )


def observe(
    truth: Truth,
    count: int,
    rng: np.random.Generator,
    *,
    pixel_noise: float = 0.25,
    pose_noise: PoseNoise | None = None,
    tilt: float = np.deg2rad(35),
    spin: float = np.deg2rad(60),
) -> list[View]:
    """Views with the board spread over the picture, tilted up to `tilt` towards the camera and
    spun up to `spin` about its normal (rad)."""
    noise = pose_noise or PoseNoise()
    views: list[View] = []
    while len(views) < count:
        X_camera_board = _random_board(truth, rng, tilt, spin)
        ids, corners = see(truth, X_camera_board)
        if len(ids) < LEAST_SEEN * len(truth.board_corners):
            continue
        X_parents = truth.X_parent_camera @ X_camera_board @ truth.X_parent_board.inverse()
        eye_to_hand = truth.mounting is Mounting.EYE_TO_HAND
        X_base_tool = X_parents if eye_to_hand else X_parents.inverse()
        views.append(
            View(
                name=f"{len(views):03d}",
                X_base_tool=X_base_tool @ _random_pose(rng, noise.translation, noise.rotation),
                ids=ids,
                corners=corners + rng.normal(0, pixel_noise, corners.shape),
            )
        )
    return views


def see(truth: Truth, X_camera_board: Transform) -> tuple[npt.NDArray[np.int64], Array]:
    """ids (n,) and exact pixels (n, 2) of the corners that fall into the picture."""
    lens = truth.intrinsics
    pixels, _ = cv2.projectPoints(
        truth.board_corners,
        X_camera_board.rotation.as_rotvec(),
        X_camera_board.translation,
        lens.as_matrix(),
        np.array(lens.distortion),
    )
    pixels = pixels.reshape(-1, 2)
    margin = 5.0  # px; a detector needs some picture around a corner
    size = np.array([lens.width, lens.height])
    inside = ((pixels > margin) & (pixels < size - 1 - margin)).all(axis=1)
    return np.flatnonzero(inside), np.asarray(pixels[inside], np.float64)


def _random_board(truth: Truth, rng: np.random.Generator, tilt: float, spin: float) -> Transform:
    """X_camera_board with the board's middle anywhere in the frustum."""
    lens = truth.intrinsics
    depth = rng.uniform(*DEPTHS[truth.mounting])
    x = (rng.uniform(0.15, 0.85) * lens.width - lens.cx) / lens.fx
    y = (rng.uniform(0.15, 0.85) * lens.height - lens.cy) / lens.fy
    direction = rng.uniform(0, 2 * np.pi)
    leaned = Rotation.from_rotvec(
        rng.uniform(0, tilt) * np.array([np.cos(direction), np.sin(direction), 0])
    )
    rotation = leaned * Rotation.from_euler("z", rng.uniform(-spin, spin))
    middle = truth.board_corners.mean(axis=0)
    return Transform(rotation, depth * np.array([x, y, 1]) - rotation.apply(middle))


def _pose(translation: list[float], axes: str, degrees: list[float]) -> Transform:
    return Transform(Rotation.from_euler(axes, degrees, degrees=True), np.array(translation))


def _random_pose(rng: np.random.Generator, metres: float, radians: float) -> Transform:
    return Transform(Rotation.from_rotvec(rng.normal(0, radians, 3)), rng.normal(0, metres, 3))
