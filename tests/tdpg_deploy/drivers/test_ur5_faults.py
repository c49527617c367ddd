"""What the driver does when people, cables, processes and the controller fail: docs/faults.md.

Each row is injected over the wire or into a process. Whatever is raised, the arm comes to rest,
stays there after the cause is mended, and moves again only when it is asked to after `recover`.
"""

from __future__ import annotations

import functools
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import pytest
from ur_rig import (
    PacedClock,
    arm_section,
    emulated_controller,
    new_host,
    processes_of,
    wait_until,
)

from tdpg_deploy import kinematics
from tdpg_deploy.drivers.ur5 import UrArm
from tdpg_deploy.drivers.ur5_network import SCRIPT_PORT
from tdpg_deploy.drivers.ur5_status import ProgramStopped
from tdpg_deploy.emulators.ur_controller.process import ControllerProcess
from tdpg_deploy.errors import (
    ArmError,
    DeviceTimeout,
    DeviceUnreachable,
    EmergencyStop,
    ProtectiveStop,
)
from tdpg_deploy.geometry import Array, Transform, top_down
from tdpg_deploy.hal import ArmState, MotionEnd

PACES = {"cb3": 4.0, "e-series": 1.5}  # the latter computes four times as often
STILL = 1e-6  # rad/s


@dataclass
class Rig:
    """An emulated controller, a driver on it, and a way there and back."""

    host: str
    clock: PacedClock
    robot: ControllerProcess
    arm: UrArm
    start: Array

    def injected(self, *commands: str | tuple[str, float]) -> None:
        for command in commands:
            if isinstance(command, str):
                self.robot.do(command)
            else:
                self.robot.do(command[0], share=command[1])

    def move(self, on_state: Callable[[ArmState], None] | None = None) -> None:
        """A radian with the base, in 2.7 s of the arm's time, or the rest of it."""
        self.arm.move_joints(
            self.goal, speed=0.4, acceleration=2.0, deadline=8.0, on_state=on_state
        )

    @property
    def goal(self) -> Array:
        turn = 1.0 if self.start[0] < np.pi / 2 else -1.0
        return np.array([self.start[0] + turn, *self.start[1:]])

    def under_way(self, act: Callable[[], object]) -> Callable[[ArmState], None]:
        """For `on_state`: act once, when the arm moves."""
        todo = [act]

        def on_state(state: ArmState) -> None:
            if todo and np.abs(state.qd).max() > 0.3:
                todo.pop()()

        return on_state

    def child(self) -> int:
        """Process id of the driver's child."""
        return next(pid for pid, words in processes_of(self.host).items() if "ur5_child" in words)

    def speed(self) -> float:
        return float(self.robot.do("truth")["speed"])

    def q(self) -> Array:
        return np.array(self.robot.do("truth")["q"])

    def comes_to_rest(self) -> Array:
        wait_until(lambda: self.speed() < STILL, deadline=1.0)
        return self.q()

    def stays_at(self, q: Array) -> None:
        """For ten samples of the truth, spread over the next moments of the arm's time."""
        for _ in range(10):
            before = self.robot.do("truth")["time"]
            wait_until(lambda before=before: self.robot.do("truth")["time"] > before)  # type: ignore[misc]
            np.testing.assert_allclose(self.q(), q, atol=1e-4)


@pytest.fixture(scope="module")
def controllers() -> Iterator[Callable[[str], tuple[str, ControllerProcess]]]:
    """One of each generation, started when it is first asked for."""
    with ExitStack() as stack:

        @functools.cache
        def controller(generation: str) -> tuple[str, ControllerProcess]:
            host, pace = new_host(), PACES[generation]
            robot = emulated_controller(host, generation=generation, pace=pace)
            return host, stack.enter_context(robot)

        yield controller


@pytest.fixture(params=["cb3"])
def rig(
    request: pytest.FixtureRequest,
    controllers: Callable[[str], tuple[str, ControllerProcess]],
) -> Iterator[Rig]:
    """The arm at rest, driver not connected."""
    host, robot = controllers(request.param)
    robot.do("reset")
    clock = PacedClock(PACES[request.param])
    arm = UrArm(arm_section(host), clock=clock)
    q = np.array(robot.do("truth")["q"])
    yield Rig(host=host, clock=clock, robot=robot, arm=arm, start=q)
    arm.close()
    assert list(processes_of(host)) == [robot.pid]


@pytest.fixture
def connected(rig: Rig) -> Rig:
    rig.arm.connect()
    return rig


on_both = pytest.mark.parametrize("rig", ["cb3", "e-series"], indirect=True)
on_e_series = pytest.mark.parametrize("rig", ["e-series"], indirect=True)


# --- the controller, while the arm moves ------------------------------------------------------

Row = tuple[tuple[str | tuple[str, float], ...], type[Exception], str, tuple[object, ...]]

UNDER_WAY: dict[str, Row] = {
    "protective stop": (("protective_stop",), ProtectiveStop, "protective stop: look", ()),
    "emergency stop": (
        ("emergency_stop",),
        EmergencyStop,
        "emergency stop: release the button",
        ("release_stop", "power_on"),
    ),
    "safeguard opened": (
        ("safeguard_stop",),
        EmergencyStop,
        "safeguard stop: close",
        ("release_stop",),
    ),
    "power off": (("power_off",), ArmError, "mode POWER_OFF.*power it on", ("power_on",)),
    "program stopped at the pendant": (("stop_program",), ProgramStopped, "does not run", ()),
    "speed slider to zero": (
        (("speed_slider", 0.0),),
        ArmError,
        "speed slider is at 0%",
        (("speed_slider", 1.0),),
    ),
    "connections reset": (("drop",), DeviceUnreachable, r"call recover\(\)", ()),
    "cable out": (("unplug",), DeviceUnreachable, r"call recover\(\)", ("plug_in",)),
    "controller hangs": (("freeze",), DeviceUnreachable, "no state came", ("thaw",)),
    "controller loses power": (
        ("lose_power",),
        DeviceUnreachable,
        r"call recover\(\)",
        ("plug_in", "power_on"),
    ),
}
BOTH_GENERATIONS = {"protective stop", "emergency stop", "safeguard opened", "cable out"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "name"),
    [("cb3", name) for name in UNDER_WAY]
    + [("e-series", name) for name in UNDER_WAY if name in BOTH_GENERATIONS],
    indirect=["rig"],
)
def test_fault_under_way(connected: Rig, name: str) -> None:
    commands, error, message, mend = UNDER_WAY[name]
    rig = connected
    with pytest.raises(error, match=message):
        rig.move(rig.under_way(lambda: rig.injected(*commands)))
    stopped_at = rig.comes_to_rest()
    assert abs(stopped_at[0] - rig.start[0]) < 0.8, "the fault came too late to matter"
    rig.injected(*mend)  # type: ignore[arg-type]
    rig.stays_at(stopped_at)
    rig.arm.recover()
    rig.stays_at(stopped_at)
    rig.move()
    np.testing.assert_allclose(rig.q(), rig.goal, atol=1e-3)


@on_e_series
@pytest.mark.slow
def test_local_control_under_way(connected: Rig) -> None:
    rig = connected
    with pytest.raises(ArmError, match="remote control is off"):
        rig.move(rig.under_way(lambda: rig.injected("local_control")))
    stopped_at = rig.comes_to_rest()
    with pytest.raises(ArmError, match="remote control is off"):
        rig.arm.recover()
    rig.injected("remote_control")
    rig.arm.recover()
    rig.stays_at(stopped_at)


@pytest.mark.slow
def test_unguarded_motion_into_the_table(connected: Rig) -> None:
    rig = connected
    above = rig.arm.move_joints(
        rig.start, speed=1.0, acceleration=1.4, deadline=5.0
    ).state.X_base_tool
    x, y, _ = above.translation
    down = Transform(above.rotation, np.array([x, y, -0.20]))
    with pytest.raises(ProtectiveStop, match=r"force of \d\d\d N"):
        rig.arm.move_linear(down, speed=0.25, acceleration=1.2, deadline=10.0)
    pressed = rig.comes_to_rest()
    rig.arm.recover()
    rig.stays_at(pressed)
    up = rig.arm.move_linear(above, speed=0.25, acceleration=1.2, deadline=10.0)
    assert up.end is MotionEnd.REACHED


# --- this machine, while the arm moves --------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "error", "message"),
    [
        (signal.SIGKILL, DeviceUnreachable, "by SIGKILL"),
        (signal.SIGSEGV, DeviceUnreachable, "by SIGSEGV"),
        (signal.SIGSTOP, DeviceTimeout, "no answer to sample within"),
    ],
)
def test_child_dies_or_hangs(
    connected: Rig, number: signal.Signals, error: type[Exception], message: str
) -> None:
    rig = connected
    with pytest.raises(error, match=message):
        rig.move(rig.under_way(lambda: os.kill(rig.child(), number)))
    stopped_at = rig.comes_to_rest()
    rig.arm.recover()
    rig.stays_at(stopped_at)


@on_both
@pytest.mark.slow
def test_process_does_not_watch_the_arm(connected: Rig) -> None:
    rig = connected
    with pytest.raises(ArmError, match=r"watchdog stopped the arm.*0\.25 s are allowed"):
        rig.move(rig.under_way(lambda: time.sleep(0.6)))  # the stall is the fault
    rig.comes_to_rest()


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_error_in_on_state(connected: Rig, error: BaseException) -> None:
    rig = connected

    def fail() -> None:
        raise error

    with pytest.raises(type(error)):
        rig.move(rig.under_way(fail))
    assert rig.speed() < STILL
    rig.move()  # nothing is broken


def test_ctrl_c_under_way(connected: Rig) -> None:
    rig = connected
    with pytest.raises(KeyboardInterrupt):
        rig.move(rig.under_way(lambda: signal.raise_signal(signal.SIGINT)))
    assert rig.speed() < STILL
    rig.move()


def test_stop_from_another_thread(connected: Rig) -> None:
    rig = connected
    thread = threading.Thread(target=rig.arm.stop)
    with pytest.raises(ArmError, match="stopped on request"):
        rig.move(rig.under_way(thread.start))
    thread.join(5.0)
    assert not thread.is_alive()
    assert rig.speed() < STILL


# --- before a motion --------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["protective stop", "power off", "speed slider to zero"])
def test_fault_at_rest(connected: Rig, name: str) -> None:
    commands, error, message, mend = UNDER_WAY[name]
    rig = connected
    rig.injected(*commands)
    with pytest.raises(error, match=message):
        rig.move()
    rig.stays_at(rig.start)
    rig.injected(*mend)  # type: ignore[arg-type]
    rig.arm.recover()
    rig.move()


@pytest.mark.slow
def test_another_program_takes_the_controller(connected: Rig) -> None:
    rig = connected
    upload(rig.host, "def other():\n  while True:\n    sync()\n  end\nend\n")
    wait_until(lambda: rig.robot.do("truth")["program"] == "other")
    with pytest.raises(DeviceTimeout, match=r"call recover\(\)"):
        rig.move()
    rig.stays_at(rig.start)
    rig.arm.recover()
    rig.move()


def test_unreachable_targets_are_refused(connected: Rig) -> None:
    rig = connected
    with pytest.raises(ArmError, match=r"cannot reach.*nothing was moved"):
        rig.arm.move_linear(top_down(1.5, 0, 0, 0), speed=0.1, acceleration=1.0, deadline=5.0)
    with pytest.raises(ArmError, match="outside of the arm's range"):
        rig.arm.move_joints(np.full(6, 7.0), speed=0.1, acceleration=1.0, deadline=5.0)
    rig.stays_at(rig.start)
    rig.move()


def test_speed_beyond_the_controllers_limits_is_refused(connected: Rig) -> None:
    rig = connected
    with pytest.raises(ArmError, match=r"refused move_joints: .*not within \[0;3\.14\]"):
        rig.arm.move_joints(rig.start + 0.1, speed=50.0, acceleration=1.0, deadline=5.0)
    rig.stays_at(rig.start)


def test_force_is_not_zeroed_under_way(connected: Rig) -> None:
    rig = connected
    with pytest.raises(ArmError, match="cannot be zeroed while the arm moves"):
        rig.move(rig.under_way(rig.arm.zero_force))


# --- while connecting -------------------------------------------------------------------------

AT_CONNECT: dict[str, Row] = {
    "not switched on": (("unplug",), DeviceUnreachable, "cannot be reached", ("plug_in",)),
    "accepts and never answers": (("freeze",), DeviceTimeout, "does not answer", ("thaw",)),
    "registers in use": (
        ("start_fieldbus",),
        ArmError,
        "input registers are in use: .*EtherNet/IP",
        ("stop_fieldbus",),
    ),
    "protective stop": (("protective_stop",), ProtectiveStop, "protective stop", ()),
    "emergency stop": (
        ("emergency_stop",),
        EmergencyStop,
        "emergency stop",
        ("release_stop", "power_on"),
    ),
    "power off": (("power_off",), ArmError, "mode POWER_OFF", ("power_on",)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", AT_CONNECT)
def test_fault_at_connect(rig: Rig, name: str) -> None:
    commands, error, message, mend = AT_CONNECT[name]
    rig.injected(*commands)
    with pytest.raises(error, match=message):
        rig.arm.connect()
    assert list(processes_of(rig.host)) == [rig.robot.pid]
    rig.injected(*mend)  # type: ignore[arg-type]
    rig.arm.recover()
    rig.stays_at(rig.start)


@on_e_series
def test_local_control_at_connect(rig: Rig) -> None:
    rig.injected("local_control")
    with pytest.raises(ArmError, match="switch the controller to remote control"):
        rig.arm.connect()


def test_second_driver_finds_the_registers_in_use(connected: Rig) -> None:
    second = UrArm(arm_section(connected.host), clock=connected.clock)
    with pytest.raises(ArmError, match="end the other program that controls this arm"):
        second.connect()
    connected.move()


@pytest.mark.parametrize("version", ["3.3.4.310", "5.3.0.64192"])
def test_old_software_is_refused(version: str) -> None:
    host = new_host()
    with emulated_controller(host, version=version):
        arm = UrArm(arm_section(host), clock=PacedClock(1.0))
        with pytest.raises(ArmError, match=f"PolyScope {version}; this driver needs"):
            arm.connect()


def test_another_arm_model_is_refused(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def taller(q: Array, X_flange_tool: Transform) -> Transform:
        pose = forward(q, X_flange_tool)
        return Transform(pose.rotation, pose.translation + np.array([0, 0, 0.0733]))

    forward = kinematics.forward
    monkeypatch.setattr(kinematics, "forward", taller)  # as a UR5e, by its d1
    with pytest.raises(ArmError, match=r"73 mm .* check arm\.model"):
        rig.arm.connect()


def test_calls_without_connection(rig: Rig) -> None:
    with pytest.raises(DeviceUnreachable, match=r"call connect\(\)"):
        rig.arm.state()
    with pytest.raises(DeviceUnreachable, match=r"call connect\(\)"):
        rig.move()
    with pytest.raises(DeviceUnreachable, match=r"call connect\(\)"):
        _ = rig.arm.version
    rig.arm.stop()
    rig.arm.close()


@pytest.mark.slow
def test_protective_stop_that_cannot_be_released(connected: Rig) -> None:
    rig = connected
    rig.injected("protective_stop")
    with pytest.raises(DeviceTimeout, match="Cannot unlock protective stop until 5s"):
        rig.arm.recover(deadline=1.0)


def upload(host: str, program: str) -> None:
    with socket.create_connection((host, SCRIPT_PORT), timeout=2.0) as connection:
        connection.sendall(program.encode())
