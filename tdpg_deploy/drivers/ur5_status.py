"""What a UR controller reports, and what that means for motion. Pure.

Numbers and names: Universal Robots, "Real-Time Data Exchange (RTDE) Guide" and "Dashboard
Server". The dashboard spells the same modes in capitals.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from tdpg_deploy.errors import ArmError, EmergencyStop, ProtectiveStop


class RobotMode(IntEnum):
    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED = 11
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13


class RuntimeState(IntEnum):
    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class ProgramStopped(ArmError):
    """The driver's program no longer runs on the controller."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One RTDE state, as plain numbers: it crosses a process border.

    q, qd: rad, rad/s. pose: UR's six numbers of the tool in base. force: N, as reported.
    slider: the operator's share of the speed, 0 to 1. operation, running: number of the last
    asynchronous motion, and whether it is under way. timestamp: s since the controller started;
    stamp: the same moment on the cell's clock, which the child does not know.
    """

    timestamp: float
    q: tuple[float, ...]
    qd: tuple[float, ...]
    pose: tuple[float, ...]
    force: tuple[float, ...]
    robot_mode: int
    safety_mode: int
    runtime_state: int
    slider: float
    operation: int
    running: bool
    stamp: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ControllerVersion:
    """PolyScope's version; what it can do follows from it."""

    major: int
    minor: int
    bugfix: int
    build: int

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}.{self.build}"

    @property
    def is_supported(self) -> bool:
        """ur_rtde's registers exist from 3.4, and from 5.4, on."""
        return (3, 4) <= (self.major, self.minor) < (4, 0) or (self.major, self.minor) >= (5, 4)

    @property
    def has_remote_control(self) -> bool:
        return (self.major, self.minor) >= (5, 6)


_ASK = "look at the arm, mend the cause, then call recover()"
_PAUSING = {
    SafetyMode.SAFEGUARD_STOP: "safeguard stop: close the safeguard",
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: "safeguard stop: close the safeguard",
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP: "enabling device let go: press it half way",
    SafetyMode.SYSTEM_EMERGENCY_STOP: "emergency stop of the cell: release it, power the arm on",
    SafetyMode.ROBOT_EMERGENCY_STOP: "emergency stop: release the button, power the arm on",
}
MIN_SLIDER = 0.01


def safety_problem(robot_mode: int, safety_mode: int) -> ArmError | None:
    """Why the arm may not move at all; None when it may."""
    if safety_mode == SafetyMode.PROTECTIVE_STOP:
        return ProtectiveStop(f"protective stop: {_ASK}")
    for mode, text in _PAUSING.items():
        if safety_mode == mode:
            return EmergencyStop(f"{text}, then call recover()")
    if safety_mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        name = _name(SafetyMode, safety_mode)
        return ArmError(f"the safety mode is {name}: restart safety at the pendant ({_ASK})")
    if robot_mode != RobotMode.RUNNING:
        name = _name(RobotMode, robot_mode)
        return ArmError(
            f"the arm is not running (mode {name}): power it on and release its brakes at the "
            "pendant, then call recover()"
        )
    return None


def motion_problem(sample: Sample) -> ArmError | None:
    """Why the arm cannot follow a motion now; None when it can."""
    if problem := safety_problem(sample.robot_mode, sample.safety_mode):
        return problem
    if sample.runtime_state != RuntimeState.PLAYING:
        name = _name(RuntimeState, sample.runtime_state)
        return ProgramStopped(
            f"the driver's program on the controller does not run (state {name}): somebody "
            "stopped it at the pendant, a target was out of reach, or this machine was too busy to "
            "keep its watchdog; call recover()"
        )
    if sample.slider < MIN_SLIDER:
        return ArmError(
            f"the speed slider is at {sample.slider:.0%}: raise it at the pendant, then call "
            "recover()"
        )
    return None


def _name(kind: type[IntEnum], number: int) -> str:
    return kind(number).name if number in list(kind) else str(number)
