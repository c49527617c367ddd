"""Robot modes, safety modes and runtime states, numbered as RTDE numbers them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class RobotMode(IntEnum):
    POWER_OFF = 3
    IDLE = 5
    RUNNING = 7


class SafetyMode(IntEnum):
    NORMAL = 1
    PROTECTIVE_STOP = 3
    SAFEGUARD_STOP = 5
    ROBOT_EMERGENCY_STOP = 7


class RuntimeState(IntEnum):
    STOPPED = 1
    PLAYING = 2
    PAUSED = 4


_SAFETY_BITS = {  # RTDE guide, "safety_status_bits"; bit 10 is "stopped due to safety"
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.SAFEGUARD_STOP: 1 << 4 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}


def safety_status_bits(mode: SafetyMode) -> int:
    return _SAFETY_BITS[mode]


def robot_status_bits(mode: RobotMode, runtime: RuntimeState) -> int:
    """Bit 0: power on; bit 1: program running."""
    return (mode is RobotMode.RUNNING) << 0 | (runtime is RuntimeState.PLAYING) << 1


@dataclass(frozen=True, kw_only=True)
class Generation:
    """A line of controllers: software version and control rate (Hz)."""

    version: tuple[int, int, int, int]
    frequency: int

    @property
    def has_remote_control(self) -> bool:
        """A switch between local and remote control came with PolyScope 5.6."""
        return self.version[:2] >= (5, 6)


CONTROLLERS = {  # by the model of the arm: a CB3 drives a UR5, an e-series controller a UR5e
    "ur5": Generation(version=(3, 15, 8, 106339), frequency=125),
    "ur5e": Generation(version=(5, 11, 1, 108318), frequency=500),
}
