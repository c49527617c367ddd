"""What a cell is made of: a camera, an arm, a gripper. SI units, base frame, deadlines.

Every implementation, simulated or real, keeps these promises (tests/hal_contract.py holds
them to it):

- A constructor opens nothing and moves nothing; `connect` opens, `close` releases and may be
  called twice. Both leave the arm still.
- Every call ends: with what was asked, or with a `DeviceError` before `deadline` seconds
  (of the cell's clock) have passed.
- What is returned was measured after the call began. Nothing is assumed or echoed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from tdpg_deploy.geometry import Array, Transform

DOF = 6


class Clock(Protocol):
    """Time of a cell. Simulated cells run their own; real cells run the machine's."""

    def now(self) -> float:
        """Seconds since the UNIX epoch (a simulated clock starts anywhere, and only grows)."""

    def sleep(self, seconds: float) -> None:
        """Let this much of the cell's time pass."""


# --- camera -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """Pinhole with Brown-Conrady distortion (k1, k2, p1, p2, k3). Pixel centres are integers."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def as_matrix(self) -> Array:
        """(3, 3) camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])


@dataclass(frozen=True, kw_only=True, eq=False)
class RgbdFrame:
    """One aligned pair.

    color: (H, W, 3) uint8 RGB. depth: (H, W) float32, metres along the optical axis of the
    colour camera, nan where unknown. captured_at: seconds on the cell's clock. sequence
    grows by at least one from frame to frame.
    """

    color: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    intrinsics: Intrinsics
    captured_at: float
    sequence: int
    serial: str


class Camera(Protocol):
    @property
    def intrinsics(self) -> Intrinsics:
        """Of the colour stream, to which depth is aligned. Known after `connect`."""

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        """A frame exposed after the call began. Raises CameraError or DeviceTimeout."""


# --- arm --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmState:
    """Measured.

    q, qd: (6,) joint positions (rad) and speeds (rad/s), base to wrist 3.
    X_base_tool: pose of the tool centre point between the closed finger tips.
    force: (3,) newtons at the tool along the axes of base, as pressed on the tool
    by the world, zeroed by `zero_force`.
    stamp: seconds on the cell's clock.
    """

    q: Array
    qd: Array
    X_base_tool: Transform
    force: Array
    stamp: float


class MotionEnd(Enum):
    REACHED = "reached"
    CONTACT = "contact"


@dataclass(frozen=True, kw_only=True)
class MotionResult:
    """How a motion ended, and where the arm stands now, at rest."""

    end: MotionEnd
    state: ArmState


OnArmState: TypeAlias = Callable[[ArmState], None]


class Arm(Protocol):
    """Moves block until the arm stands still. Each call makes at most one motion."""

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def state(self) -> ArmState: ...

    def zero_force(self) -> None:
        """Take the present force as zero. The arm must stand still in free space."""

    def move_joints(
        self,
        q: Array,
        *,
        speed: float,
        acceleration: float,
        deadline: float,
        on_state: OnArmState | None = None,
    ) -> MotionResult:
        """Straight in joint space to q (6,) rad; speed in rad/s, acceleration in rad/s^2.

        Stops at the force guard of `move_linear` never: keep it away from objects.
        """

    def move_linear(
        self,
        X_base_tool: Transform,
        *,
        speed: float,
        acceleration: float,
        deadline: float,
        stop_force: float | None = None,
        on_state: OnArmState | None = None,
    ) -> MotionResult:
        """Straight in space; speed in m/s, acceleration in m/s^2.

        With `stop_force` (N, change since the last `zero_force`) the arm halts as soon as the
        force exceeds it and the result ends in CONTACT.
        `on_state` receives measured states while moving, at 20 Hz or more.
        """

    def stop(self) -> None:
        """Halt now. Safe to call at any time, from any state, more than once."""


# --- gripper ----------------------------------------------------------------------------------


class Holding(Enum):
    """What the gripper itself believes after a move."""

    NOTHING = "nothing"
    OBJECT = "object"
    UNKNOWN = "unknown"


@dataclass(frozen=True, kw_only=True)
class GripperState:
    """Measured. width: metres between the finger pads. stamp: seconds on the cell's clock."""

    width: float
    moving: bool
    holding: Holding
    stamp: float


class Gripper(Protocol):
    @property
    def max_width(self) -> float:
        """Metres between the pads when fully open."""

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def activate(self, *, deadline: float = 10.0) -> None:
        """Make ready. The fingers may travel their whole way: keep clear. Idempotent."""

    def state(self) -> GripperState: ...

    def move(
        self, width: float, *, speed: float, force: float, deadline: float = 5.0
    ) -> GripperState:
        """Drive the pads to `width` (m) at `speed` (m/s) until there, or blocked at `force` (N).

        Out-of-range speed and force are clamped to what the gripper can do.
        """
