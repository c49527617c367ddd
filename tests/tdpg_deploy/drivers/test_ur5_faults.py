"""Every row of docs/faults.md about the arm, its network and its operator, injected."""

from __future__ import annotations

import functools
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
import pytest
from fault_table import Deed, StillCamera, check_log, config, strike, table
from kinematic_cell import FakeGripper, Table
from ur_rig import (
    PacedClock,
    arm_section,
    emulated_controller,
    new_host,
    processes_of,
    wait_until,
)

from tdpg_deploy import cell_config
from tdpg_deploy.cell import Cell
from tdpg_deploy.cell_config import ArmSection
from tdpg_deploy.drivers import ur5
from tdpg_deploy.drivers.ur5 import UrArm
from tdpg_deploy.drivers.ur5_network import SCRIPT_PORT
from tdpg_deploy.emulators.ur_controller.process import ControllerProcess
from tdpg_deploy.geometry import Array, Transform, top_down
from tdpg_deploy.hal import ArmState, OnArmState
from tdpg_deploy.kinematics import MODELS

PACES = {"ur5": 4.0, "ur5e": 2.0}  # the latter's controller computes four times as often
STILL = 1e-6  # rad/s
Command: TypeAlias = "str | tuple[str, float]"
Controllers: TypeAlias = Callable[[str], tuple[str, ControllerProcess]]


# --- an arm to do harm to ---------------------------------------------------------------------


@dataclass
class Rig:
    """An emulated controller, a driver on it, and a way there and back.

    record: takes what a motion measures to the log.
    """

    section: ArmSection
    clock: PacedClock
    robot: ControllerProcess
    arm: UrArm
    start: Array
    patch: pytest.MonkeyPatch
    record: OnArmState = lambda state: None

    @property
    def host(self) -> str:
        return self.section.host

    def cell(self) -> Cell:
        """Of this arm and others' doubles; home is where the arm stands, so that nothing moves
        before the fault."""
        cell = config()
        arm = self.section.model_copy(update={"home": tuple(self.start.tolist())})
        return Cell(
            config=cell.model_copy(update={"arm": arm}),
            camera=StillCamera(self.clock),
            arm=self.arm,
            gripper=FakeGripper(Table(cell)),
            clock=self.clock,
        )

    @property
    def goal(self) -> Array:
        turn = 1.0 if self.start[0] < np.pi / 2 else -1.0
        return np.array([self.start[0] + turn, *self.start[1:]])

    def move(
        self,
        on_state: Callable[[ArmState], None] | None = None,
        *,
        speed: float = 0.4,
        deadline: float = 60.0,
    ) -> None:
        """A radian with the base, or what is left of it."""

        def watch(state: ArmState) -> None:
            self.record(state)
            if on_state is not None:
                on_state(state)

        self.arm.move_joints(
            self.goal, speed=speed, acceleration=5.0, deadline=deadline, on_state=watch
        )

    def do(self, *commands: Command) -> None:
        """At the pendant, the buttons and the cables."""
        for command in commands:
            if isinstance(command, str):
                self.robot.do(command)
            else:
                self.robot.do(command[0], share=command[1])

    def child(self) -> int:
        """Process id of the driver's child."""
        (pid,) = (pid for pid, words in processes_of(self.host).items() if "ur5_child" in words)
        return pid

    def q(self) -> Array:
        return np.array(self.robot.do("truth")["q"])

    def comes_to_rest(self) -> Array:
        wait_until(lambda: self.robot.do("truth")["speed"] < STILL)
        return self.q()

    def stays_at(self, q: Array) -> None:
        """For half a second of the controller's time."""
        end = self.robot.do("truth")["time"] + 0.5
        wait_until(lambda: self.robot.do("truth")["time"] > end)
        np.testing.assert_allclose(self.q(), q, atol=1e-4)


@pytest.fixture(scope="module")
def controllers() -> Iterator[Controllers]:
    """One of each kind, started when it is first asked for."""
    with ExitStack() as stack:

        @functools.cache
        def controller(kind: str) -> tuple[str, ControllerProcess]:
            host = new_host()
            if kind in PACES:
                robot = emulated_controller(host, model=kind, pace=PACES[kind])
            else:
                robot = emulated_controller(host, version=kind)
            return host, stack.enter_context(robot)

        yield controller


@pytest.fixture
def rig(on: str, controllers: Controllers, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    """The arm at rest, driver not connected."""
    host, robot = controllers(on)
    robot.do("reset")
    clock = PacedClock(PACES.get(on, 1.0))
    section = arm_section(host, on if on in PACES else "ur5")
    arm = UrArm(section, clock=clock)
    q = np.array(robot.do("truth")["q"])
    rig = Rig(section=section, clock=clock, robot=robot, arm=arm, start=q, patch=monkeypatch)
    yield rig
    rig.arm.close()
    assert list(processes_of(host)) == [robot.pid]


# --- faults -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Fault:
    """before: done before the cell is opened. provoke: raises, in an episode; None where opening
    does. mend: what a person does. then: what it takes to move again."""

    before: Callable[[Rig], object] = lambda rig: None
    provoke: Callable[[Rig], object] = lambda rig: None
    mend: tuple[Command, ...] = ()
    then: Literal["recover", "move", "nothing"] = "recover"


def commanded(*commands: Command) -> Callable[[Rig], None]:
    return lambda rig: rig.do(*commands)


def at_rest(*commands: Command) -> Callable[[Rig], None]:
    def provoke(rig: Rig) -> None:
        rig.do(*commands)
        rig.move()

    return provoke


def under_way(act: Callable[[Rig], object]) -> Callable[[Rig], None]:
    """The deed happens once, when the arm moves."""

    def provoke(rig: Rig) -> None:
        todo = [act]

        def on_state(state: ArmState) -> None:
            if todo and np.abs(state.qd).max() > 0.3:
                todo.pop()(rig)

        rig.move(on_state)

    return provoke


def injected(*commands: Command) -> Callable[[Rig], None]:
    return under_way(lambda rig: rig.do(*commands))


def signalled(number: signal.Signals) -> Callable[[Rig], None]:
    return under_way(lambda rig: os.kill(rig.child(), number))


def taken_for(model: str) -> Callable[[Rig], None]:
    def before(rig: Rig) -> None:
        rig.section = rig.section.model_copy(update={"model": model})
        rig.arm = UrArm(rig.section, clock=rig.clock)

    return before


def another_arm(rig: Rig) -> None:
    """By the upper arm of a UR10."""
    models = {name: replace(dh, a2=-0.612) for name, dh in MODELS.items()}
    rig.patch.setattr(cell_config, "MODELS", models)
    rig.patch.setattr(ur5, "MODELS", models)


def second_driver(rig: Rig) -> None:
    UrArm(rig.section, clock=rig.clock).connect()


def another_program(rig: Rig) -> None:
    with socket.create_connection((rig.host, SCRIPT_PORT), timeout=2.0) as connection:
        connection.sendall(b"def other():\n  while True:\n    sync()\n  end\nend\n")
        wait_until(lambda: rig.robot.do("truth")["program"] == "other")
    rig.move()


def not_connected(rig: Rig) -> None:
    arm = UrArm(rig.section, clock=rig.clock)
    arm.move_joints(rig.goal, speed=0.4, acceleration=5.0, deadline=60.0)


def link_lost(rig: Rig) -> None:
    rig.do("drop")
    wait_until(lambda: rig.arm.state() is None)  # raises once the loss is felt


def out_of_reach(rig: Rig) -> None:
    rig.arm.move_linear(top_down(1.5, 0, 0, 0), speed=0.1, acceleration=1.0, deadline=5.0)


def joints_by(change: float, speed: float) -> Callable[[Rig], None]:
    def provoke(rig: Rig) -> None:
        rig.arm.move_joints(rig.start + change, speed=speed, acceleration=1.0, deadline=5.0)

    return provoke


def unlocked_too_soon(rig: Rig) -> None:
    rig.do("protective_stop")
    rig.arm.recover(deadline=1.0)


def collision(rig: Rig) -> None:
    """Leaves the tool pressed on the table: the joints must not be turned from there."""
    above = rig.arm.state().X_base_tool
    down = Transform(above.rotation, np.array([*above.translation[:2], -0.20]))
    try:
        rig.arm.move_linear(down, speed=0.25, acceleration=1.2, deadline=10.0, on_state=rig.record)
    finally:
        rig.start = rig.comes_to_rest()


def drive_up(rig: Rig) -> None:
    pressed = rig.arm.state().X_base_tool
    up = Transform(pressed.rotation, pressed.translation + np.array([0, 0, 0.4]))
    rig.arm.move_linear(up, speed=0.5, acceleration=1.2, deadline=10.0)


def too_slow(rig: Rig) -> None:
    rig.move(deadline=0.5)


def slider_low(rig: Rig) -> None:
    rig.do(("speed_slider", 0.05))
    rig.move(deadline=4.0)


def not_watched(rig: Rig) -> None:
    """The caller holds the driver up until the controller has lost its patience."""
    wait_until(lambda: rig.robot.do("truth")["runtime"] != "PLAYING")


def caller_fails(rig: Rig) -> None:
    raise OSError("disk full")


RELEASED = ("release_stop", "power_on")
FAULTS = {
    "not-reachable": Fault(before=commanded("unplug"), mend=("plug_in",)),
    "silent-at-connect": Fault(before=commanded("freeze"), mend=("thaw",)),
    "old-cb3-software": Fault(then="nothing"),
    "old-e-series-software": Fault(then="nothing"),
    "ur5e-for-ur5": Fault(before=taken_for("ur5"), then="nothing"),
    "ur5-for-ur5e": Fault(before=taken_for("ur5e"), then="nothing"),
    "another-arm": Fault(before=another_arm, then="nothing"),
    "registers-in-use": Fault(before=commanded("start_fieldbus"), mend=("stop_fieldbus",)),
    "second-driver": Fault(provoke=second_driver, then="move"),
    "local-at-connect": Fault(before=commanded("local_control"), mend=("remote_control",)),
    "program-refused": Fault(before=commanded("local_control"), mend=("remote_control",)),
    "protective-stop-at-connect": Fault(before=commanded("protective_stop")),
    "emergency-stop-at-connect": Fault(before=commanded("emergency_stop"), mend=RELEASED),
    "power-off-at-connect": Fault(before=commanded("power_off"), mend=("power_on",)),
    "not-connected": Fault(provoke=not_connected, then="move"),
    "protective-stop-at-rest": Fault(provoke=at_rest("protective_stop")),
    "power-off-at-rest": Fault(provoke=at_rest("power_off"), mend=("power_on",)),
    "slider-zero-at-rest": Fault(
        provoke=at_rest(("speed_slider", 0.0)), mend=(("speed_slider", 1.0),)
    ),
    "program-stopped-at-rest": Fault(provoke=at_rest("stop_program")),
    "another-program": Fault(provoke=another_program),
    "link-lost-at-rest": Fault(provoke=link_lost),
    "out-of-reach": Fault(provoke=out_of_reach, then="move"),
    "beyond-joint-range": Fault(provoke=joints_by(7.0, 0.1), then="move"),
    "beyond-speed-range": Fault(provoke=joints_by(0.1, 50.0), then="move"),
    "unlocked-too-soon": Fault(provoke=unlocked_too_soon),
    "protective-stop": Fault(provoke=injected("protective_stop")),
    "collision": Fault(provoke=collision),
    "emergency-stop": Fault(provoke=injected("emergency_stop"), mend=RELEASED),
    "safeguard": Fault(provoke=injected("safeguard_stop"), mend=("release_stop",)),
    "power-off": Fault(provoke=injected("power_off"), mend=("power_on",)),
    "program-stopped": Fault(provoke=injected("stop_program")),
    "local-control": Fault(provoke=injected("local_control"), mend=("remote_control",)),
    "slider-zero": Fault(provoke=injected(("speed_slider", 0.0)), mend=(("speed_slider", 1.0),)),
    "slider-low": Fault(provoke=slider_low, mend=(("speed_slider", 1.0),), then="move"),
    "connections-reset": Fault(provoke=injected("drop")),
    "cable-out": Fault(provoke=injected("unplug"), mend=("plug_in",)),
    "controller-hangs": Fault(provoke=injected("freeze"), mend=("thaw",)),
    "controller-loses-power": Fault(provoke=injected("lose_power"), mend=("plug_in", "power_on")),
    "child-killed": Fault(provoke=signalled(signal.SIGKILL)),
    "child-crashed": Fault(provoke=signalled(signal.SIGSEGV)),
    "child-hangs": Fault(provoke=signalled(signal.SIGSTOP)),
    "not-watched": Fault(provoke=under_way(not_watched)),
    "caller-fails": Fault(provoke=under_way(caller_fails), then="move"),
    "ctrl-c": Fault(provoke=under_way(lambda rig: signal.raise_signal(signal.SIGINT)), then="move"),
    "stopped": Fault(
        provoke=under_way(lambda rig: threading.Thread(target=rig.arm.stop).start()), then="move"
    ),
    "too-slow": Fault(provoke=too_slow, then="move"),
    "force-zeroed": Fault(provoke=under_way(lambda rig: rig.arm.zero_force()), then="move"),
}


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.parametrize(
    ("name", "on"),
    [pytest.param(name, on, id=f"{name}-{on}") for name in FAULTS for on in table()[name].on],
)
def test_fault(name: str, rig: Rig, tmp_path: Path) -> None:
    fault, row, log = FAULTS[name], table()[name], tmp_path / "episode.mcap"
    before = rig.q()
    fault.before(rig)
    deed = Deed(lambda: fault.provoke(rig))
    rig.record = lambda state: deed.record(state)
    with ExitStack() as open_cells:
        raised = strike(rig.cell(), deed, log, open_cells)
        assert type(raised) is row.raised
        assert row.is_told_by(str(raised))
        stopped_at = rig.comes_to_rest()
        check_log(log, row, raised)
        assert (np.abs(stopped_at - before).max() > 1e-3) == (row.arm == "stops")
        assert abs(stopped_at[0] - rig.goal[0]) > 0.05, "the fault came too late to matter"
        rig.do(*fault.mend)
        rig.stays_at(stopped_at)
        if fault.then == "recover":
            rig.arm.recover()
            rig.stays_at(stopped_at)
        if name == "collision":
            drive_up(rig)
        elif fault.then != "nothing":
            rig.move(speed=2.0)
            np.testing.assert_allclose(rig.q(), rig.goal, atol=1e-3)
