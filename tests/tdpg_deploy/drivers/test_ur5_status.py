"""What reported numbers mean; numbers and names from UR's RTDE guide."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tdpg_deploy.drivers.ur5_status import (
    ControllerVersion,
    ProgramStopped,
    Sample,
    motion_problem,
    safety_problem,
)
from tdpg_deploy.errors import ArmError, EmergencyStop, ProtectiveStop

READY = Sample(
    timestamp=1.0,
    q=(0.0,) * 6,
    qd=(0.0,) * 6,
    pose=(0.0,) * 6,
    force=(0.0,) * 3,
    robot_mode=7,
    safety_mode=1,
    runtime_state=2,
    slider=1.0,
    operation=0,
    running=False,
)


def test_ready_and_reduced_arms_may_move() -> None:
    assert motion_problem(READY) is None
    assert motion_problem(replace(READY, safety_mode=2, slider=0.05)) is None


@pytest.mark.parametrize(
    ("safety_mode", "error", "message"),
    [
        (3, ProtectiveStop, "protective stop"),
        (4, ArmError, "RECOVERY"),
        (5, EmergencyStop, "safeguard stop: close"),
        (6, EmergencyStop, "emergency stop of the cell"),
        (7, EmergencyStop, "release the button"),
        (8, ArmError, "VIOLATION"),
        (9, ArmError, "FAULT"),
        (12, EmergencyStop, "safeguard stop"),
        (13, EmergencyStop, "enabling device"),
        (99, ArmError, "safety mode is 99"),
    ],
)
def test_safety_modes(safety_mode: int, error: type[ArmError], message: str) -> None:
    problem = safety_problem(7, safety_mode)
    assert type(problem) is error
    assert message in str(problem)
    assert "recover()" in str(problem)


@pytest.mark.parametrize(
    ("robot_mode", "name"), [(-1, "NO_CONTROLLER"), (3, "POWER_OFF"), (5, "IDLE"), (42, "42")]
)
def test_robot_modes(robot_mode: int, name: str) -> None:
    problem = safety_problem(robot_mode, 1)
    assert f"mode {name}" in str(problem)


def test_safety_is_named_before_its_consequences() -> None:
    stopped = replace(READY, safety_mode=7, robot_mode=3, runtime_state=1, slider=0.0)
    assert type(motion_problem(stopped)) is EmergencyStop


@pytest.mark.parametrize(("runtime_state", "name"), [(1, "STOPPED"), (4, "PAUSED")])
def test_program_that_does_not_run(runtime_state: int, name: str) -> None:
    problem = motion_problem(replace(READY, runtime_state=runtime_state))
    assert isinstance(problem, ProgramStopped)
    assert f"state {name}" in str(problem)


def test_speed_slider() -> None:
    assert "speed slider is at 0%" in str(motion_problem(replace(READY, slider=0.0)))


@pytest.mark.parametrize(
    ("major", "minor", "supported", "remote"),
    [
        (3, 3, False, False),
        (3, 4, True, False),
        (3, 15, True, False),
        (5, 3, False, False),
        (5, 5, True, False),
        (5, 6, True, True),
        (5, 11, True, True),
    ],
)
def test_versions(major: int, minor: int, supported: bool, remote: bool) -> None:
    version = ControllerVersion(major=major, minor=minor, bugfix=1, build=2)
    assert version.is_supported is supported
    assert version.has_remote_control is remote
    assert str(version) == f"{major}.{minor}.1.2"
