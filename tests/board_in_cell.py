"""Where a calibration board and the camera are in tests of a whole cell."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.target import CharucoTarget
from tdpg_deploy.cell_config import CellConfig, Pose
from tdpg_deploy.geometry import Array, Transform

TARGET = CharucoTarget(columns=7, rows=5, square=0.024, marker=0.018)
# Held by an edge before the fingers, its face against the tool's axis.
X_TOOL_BOARD = Transform(
    Rotation.from_euler("z", -92, degrees=True), np.array([0.04, 0.084, -0.005])
)
# A camera beside the gripper that looks along it, and a board on the table, face up.
X_TOOL_CAMERA = Transform(Rotation.from_euler("X", 10, degrees=True), np.array([0.0, -0.08, -0.10]))
X_BASE_BOARD = Transform(
    Rotation.from_euler("XZ", [180, 90], degrees=True), np.array([0.45, 0.09, -0.149])
)


def pose_section(X: Transform) -> Pose:
    x, y, z = (float(v) for v in X.translation)
    qx, qy, qz, qw = (float(v) for v in X.as_quaternion())
    return Pose(position=(x, y, z), quaternion=(qx, qy, qz, qw))


def moved(X: Transform, metres: float, degrees: float) -> Transform:
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array([0.6, -0.64, 0.48]))
    return X @ Transform(turn, metres * np.array([0.6, -0.64, 0.48]))


def with_true_camera(config: CellConfig, X_base_camera: Transform) -> CellConfig:
    simulation = config.simulation.model_copy(
        update={"X_base_camera": pose_section(X_base_camera), "depth_noise": False}
    )
    return config.model_copy(update={"simulation": simulation})


def workspace_grid(config: CellConfig) -> Array:
    """(n, 3) in base: five by five places, on the table and 0.1 m above."""
    x, y = (np.linspace(*side, 5) for side in (config.workspace.x_range, config.workspace.y_range))
    table_z = config.workspace.table_z
    return np.stack(np.meshgrid(x, y, [table_z, table_z + 0.1]), axis=-1).reshape(-1, 3)
