"""A cell whose camera sees a calibration board: painted into its pictures where it would be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.pictures import paint_board
from calibration.target import CharucoTarget
from calibration.views import Mounting
from tdpg_deploy.cell_config import CellConfig, Pose
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Arm, Camera, Clock, Intrinsics, RgbdFrame

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


class BoardCamera:
    """A cell's camera, with the board painted in, and in front of a plain table when it is on the
    tool. X_parent_camera: the truth."""

    def __init__(
        self, camera: Camera, arm: Arm, mounting: Mounting, X_parent_camera: Transform
    ) -> None:
        self._camera, self._arm = camera, arm
        self._mounting, self._X_parent_camera = mounting, X_parent_camera

    @property
    def intrinsics(self) -> Intrinsics:
        return self._camera.intrinsics

    def connect(self) -> None:
        self._camera.connect()

    def close(self) -> None:
        self._camera.close()

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        frame = self._camera.capture(deadline=deadline)
        X_base_tool = self._arm.state().X_base_tool
        if self._mounting is Mounting.EYE_TO_HAND:
            X_camera_board = self._X_parent_camera.inverse() @ X_base_tool @ X_TOOL_BOARD
            color, depth = frame.color, frame.depth.copy()
        else:
            X_camera_board = (X_base_tool @ self._X_parent_camera).inverse() @ X_BASE_BOARD
            color = np.full_like(frame.color, 110)
            depth = np.full_like(frame.depth, np.nan)
        color = paint_board(color, TARGET, X_camera_board, frame.intrinsics, depth)
        return replace(frame, color=color, depth=depth)


class BoardCell:
    """`calibration.collection.Devices` of a connected cell, with the board in its pictures."""

    def __init__(
        self, camera: Camera, arm: Arm, clock: Clock, mounting: Mounting, X_parent_camera: Transform
    ) -> None:
        self.arm: Arm = arm
        self.clock: Clock = clock
        self.camera: Camera = BoardCamera(camera, arm, mounting, X_parent_camera)


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
