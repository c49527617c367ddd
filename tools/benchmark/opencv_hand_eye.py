"""OpenCV's hand-eye methods on the same pictures and poses, as labs call them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from calibration.closed_form import board_pose
from calibration.views import View
from tdpg_deploy.geometry import Array, Transform
from tools.benchmark.calibration_cases import Case

HAND_EYE = {
    "Tsai": cv2.CALIB_HAND_EYE_TSAI,
    "Park": cv2.CALIB_HAND_EYE_PARK,
    "Horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "Andreff": cv2.CALIB_HAND_EYE_ANDREFF,
    "Daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
ROBOT_WORLD = {
    "robot-world Shah": cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
    "robot-world Li": cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI,
}


def solve_with_opencv(case: Case) -> dict[str, Transform]:
    """X_parent_camera by each of the methods."""
    mounting = case.truth.mounting
    # OpenCV speaks of eye-in-hand; for eye-to-hand its "gripper in base" is base in tool.
    parents = [view.X_parents(mounting).inverse() for view in case.views]
    boards = _board_poses(case.views, case)
    R, t = _split(parents)
    R_boards, t_boards = _split(boards)
    found = {}
    for name, method in HAND_EYE.items():
        # By keyword: a positional method is ignored, and Tsai runs.
        rotation, translation = cv2.calibrateHandEye(R, t, R_boards, t_boards, method=method)
        found[name] = _transform(rotation, translation)
    inverse_R, inverse_t = _split([X.inverse() for X in parents])
    for name, method in ROBOT_WORLD.items():
        _, _, rotation, translation = cv2.calibrateRobotWorldHandEye(
            R_boards, t_boards, inverse_R, inverse_t, method=method
        )
        found[name] = _transform(rotation, translation).inverse()
    return found


def _board_poses(views: Sequence[View], case: Case) -> list[Transform]:
    return [board_pose(view, case.board_corners, case.intrinsics) for view in views]


def _split(poses: Sequence[Transform]) -> tuple[list[Array], list[Array]]:
    return [X.rotation.as_matrix() for X in poses], [X.translation[:, None] for X in poses]


def _transform(rotation: npt.ArrayLike, translation: npt.ArrayLike) -> Transform:
    matrix = np.eye(4)
    u, _, vt = np.linalg.svd(np.asarray(rotation, np.float64))
    matrix[:3, :3], matrix[:3, 3] = u @ vt, np.ravel(translation)
    return Transform.from_matrix(matrix)
