"""A simulated cell's camera that sees a calibration board, painted in where it would be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.pictures import paint_board
from calibration.target import CharucoTarget
from calibration.views import Mounting
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Arm, Camera, Clock, Intrinsics, RgbdFrame

PLAIN = 110  # grey level


@dataclass(frozen=True, kw_only=True, eq=False)
class PaintedBoard:
    """The truth: X_parent_camera and X_parent_board as in `calibration.projection`."""

    mounting: Mounting
    target: CharucoTarget
    X_parent_camera: Transform
    X_parent_board: Transform

    def X_camera_board(self, X_base_tool: Transform) -> Transform:
        arm = X_base_tool if self.mounting is Mounting.EYE_TO_HAND else X_base_tool.inverse()
        return self.X_parent_camera.inverse() @ arm @ self.X_parent_board


class BoardCamera:
    """The board hides behind what is nearer. A camera on the tool, which the simulation does not
    have, sees nothing but the board."""

    def __init__(self, camera: Camera, arm: Arm, board: PaintedBoard) -> None:
        self._camera, self._arm, self._board = camera, arm, board

    @property
    def intrinsics(self) -> Intrinsics:
        return self._camera.intrinsics

    def connect(self) -> None:
        self._camera.connect()

    def close(self) -> None:
        self._camera.close()

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        frame = self._camera.capture(deadline=deadline)
        color, depth = frame.color, frame.depth.copy()
        if self._board.mounting is Mounting.EYE_IN_HAND:
            color, depth = np.full_like(color, PLAIN), np.full_like(depth, np.nan)
        X_camera_board = self._board.X_camera_board(self._arm.state().X_base_tool)
        target = self._board.target
        color = paint_board(color, target, X_camera_board, frame.intrinsics, depth)
        return replace(frame, color=color, depth=depth)


class BoardCell:
    """A connected cell as `calibration.collection.Devices`, with the board in its pictures."""

    def __init__(self, camera: Camera, arm: Arm, clock: Clock, board: PaintedBoard) -> None:
        self.camera: Camera = BoardCamera(camera, arm, board)
        self.arm = arm
        self.clock = clock
