"""Poses in other programs' formats: easy_handeye, VPG, ROS."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.views import Mounting
from tdpg_deploy.calibration_file import Calibration, read_yaml
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Transform

_QUATERNION = ("qx", "qy", "qz", "qw")


@dataclass(frozen=True, kw_only=True, eq=False)
class ForeignPose:
    """What such a file holds: a pose without its error.

    depth_scale: true depth over measured, 1 where the format has none.
    """

    mounting: Mounting
    X_parent_camera: Transform
    depth_scale: float = 1.0


def import_easy_handeye(path: Path) -> ForeignPose:
    """easy_handeye's YAML (parameters, transformation). Raises CalibrationError."""
    data = read_yaml(path)
    try:
        parameters, t = data["parameters"], data["transformation"]
        on_hand = bool(parameters["eye_on_hand"])
        position = [float(t[axis]) for axis in "xyz"]
        quaternion = [float(t[axis]) for axis in _QUATERNION]
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f"{path}: not easy_handeye's format: {error} is missing or no number; it has "
            "parameters.eye_on_hand and transformation.x, y, z, qx, qy, qz, qw"
        ) from error
    if abs(np.linalg.norm(quaternion) - 1) > 1e-2:
        raise CalibrationError(f"{path}: the quaternion has norm {np.linalg.norm(quaternion):.3f}")
    return ForeignPose(
        mounting=Mounting.EYE_IN_HAND if on_hand else Mounting.EYE_TO_HAND,
        X_parent_camera=Transform.from_quaternion(position, quaternion),
    )


def export_easy_handeye(calibration: Calibration) -> str:
    on_hand = calibration.mounting == "eye-in-hand"
    pose = calibration.pose
    names = ["x", "y", "z", *_QUATERNION]
    values = [*pose.position, *pose.quaternion]
    lines = [f"  {name}: {value!r}" for name, value in zip(names, values, strict=True)]
    return "\n".join(
        [
            "parameters:",
            f"  eye_on_hand: {str(on_hand).lower()}",
            "  robot_base_frame: base",
            "  robot_effector_frame: tool",
            "  tracking_base_frame: camera",
            "transformation:",
            *lines,
            "",
        ]
    )


def import_vpg(camera_pose: Path, depth_scale: Path | None = None) -> ForeignPose:
    """VPG's camera_pose.txt (4 x 4, camera in base) and camera_depth_scale.txt."""
    matrix = _numbers(camera_pose)
    if matrix.size != 16:
        raise CalibrationError(f"{camera_pose}: {matrix.size} numbers; VPG's has 4 x 4")
    try:
        X = Transform.from_matrix(matrix.reshape(4, 4))
    except ValueError as error:
        raise CalibrationError(f"{camera_pose}: {error}") from error
    scale = 1.0
    if depth_scale is not None:
        values = _numbers(depth_scale)
        if values.size != 1 or not 0.8 < values.flat[0] < 1.2:
            raise CalibrationError(f"{depth_scale}: expected one number near 1, got {values}")
        scale = float(values.flat[0])
    return ForeignPose(mounting=Mounting.EYE_TO_HAND, X_parent_camera=X, depth_scale=scale)


def export_vpg(calibration: Calibration) -> tuple[str, str]:
    """camera_pose.txt and camera_depth_scale.txt.

    The scale is the depth model's at 0.7 m: the format cannot hold more.
    """
    if calibration.mounting != "eye-to-hand":
        raise CalibrationError("VPG's format is for a fixed camera; this one is eye-in-hand")
    rows = calibration.pose.transform().as_matrix()
    text = "\n".join(" ".join(f"{value:.18e}" for value in row) for row in rows)
    depth = calibration.depth
    scale = 1.0 if depth is None else 1 / (depth.a + depth.b * 0.7)
    return text + "\n", f"{scale:.18e}\n"


def export_ros(calibration: Calibration, camera_frame: str = "camera_color_optical_frame") -> str:
    """A command that publishes the pose. UR's `base` is ROS's `base`; `base_link` is turned by
    180 degrees about z."""
    x, y, z = calibration.pose.position
    qx, qy, qz, qw = calibration.pose.quaternion
    parent = "base" if calibration.parent == "base" else "tool0_controller"
    return (
        "ros2 run tf2_ros static_transform_publisher "
        f"--x {x!r} --y {y!r} --z {z!r} --qx {qx!r} --qy {qy!r} --qz {qz!r} --qw {qw!r} "
        f"--frame-id {parent} --child-frame-id {camera_frame}\n"
    )


def _numbers(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    try:
        return np.loadtxt(path, dtype=np.float64)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read ({error})") from error
    except ValueError as error:
        raise CalibrationError(f"{path}: {error}; it should hold numbers only") from error
