"""What a calibration is computed from: views of the board, and where the arm stood for each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from tdpg_deploy.geometry import Array, Transform


class Mounting(Enum):
    """Where the camera is. The board is on the other side: held by the tool, or fixed in base."""

    EYE_TO_HAND = "eye-to-hand"
    EYE_IN_HAND = "eye-in-hand"

    @property
    def camera_parent(self) -> str:
        """The frame in which the camera stands still."""
        return "base" if self is Mounting.EYE_TO_HAND else "tool"

    @property
    def board_parent(self) -> str:
        """The frame in which the board stands still."""
        return "tool" if self is Mounting.EYE_TO_HAND else "base"

    @property
    def other(self) -> Mounting:
        return Mounting.EYE_IN_HAND if self is Mounting.EYE_TO_HAND else Mounting.EYE_TO_HAND


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """One picture of the board with the arm at rest.

    X_base_tool: the controller's actual pose, not nominal kinematics (4 mm apart on a UR5).
    ids: (n,) indices into the board's inner corners. corners: (n, 2) pixels, centres integer.
    """

    name: str
    X_base_tool: Transform
    ids: npt.NDArray[np.int64]
    corners: Array

    def X_parents(self, mounting: Mounting) -> Transform:
        """Pose of the board's parent frame in the camera's parent frame."""
        if mounting is Mounting.EYE_TO_HAND:
            return self.X_base_tool
        return self.X_base_tool.inverse()


@dataclass(frozen=True, kw_only=True)
class PoseNoise:
    """Standard deviation of the arm's reported pose, per axis, at the tool.

    The default is the repeatability of a UR5e (datasheet: 0.03 mm). `solve` raises it when the
    views say that the arm is worse.
    """

    translation: float = 0.03e-3
    rotation: float = 0.05e-3

    def variances(self) -> Array:
        """(6,) rad^2 about, then m^2 along the axes of the tool."""
        return np.repeat([self.rotation**2, self.translation**2], 3)
