"""Every row of docs/faults.md about gripper and camera, injected."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest
from emulated_d435 import SERIAL, Scene, emulated
from fault_table import Deed, Row, StillCamera, check_log, config, picture, strike, table
from kinematic_cell import FakeArm, FakeGripper, Table
from robotiq_on_wires import WIRES, Bench, bench_on

from tdpg_deploy.cell import Cell, MachineClock
from tdpg_deploy.drivers import realsense
from tdpg_deploy.drivers.realsense import RealsenseCamera
from tdpg_deploy.drivers.realsense_frames import to_intrinsics
from tdpg_deploy.drivers.realsense_source import RealsenseSource
from tdpg_deploy.drivers.robotiq import RobotiqGripper, RobotiqWire
from tdpg_deploy.drivers.robotiq_rtu import rtu_over_tcp_wire, serial_wire
from tdpg_deploy.drivers.robotiq_urcap import UrcapWire
from tdpg_deploy.emulators.realsense import EmulatedD435, depth_lost, holes, stale, stalled, torn
from tdpg_deploy.emulators.realsense import Fault as CameraFault
from tdpg_deploy.emulators.robotiq import FaultCode
from tdpg_deploy.emulators.robotiq_modbus import frame
from tdpg_deploy.emulators.robotiq_wires import corrupt, late, mute


@pytest.fixture
def arm() -> FakeArm:
    """It stands at home, and is asked to go nowhere."""
    return FakeArm(Table(config()))


def check(
    row: Row,
    cell: Cell,
    arm: FakeArm,
    act: Callable[[], object],
    directory: Path,
    open_cells: ExitStack,
) -> None:
    """The fault strikes an episode, and all that its row says holds."""
    log = directory / "episode.mcap"
    raised = strike(cell, Deed(act), log, open_cells)
    assert type(raised) is row.raised
    assert row.is_told_by(str(raised))
    assert (row.arm, arm.motions) == ("stays", [])
    assert (arm.stops > 0) == (row.log != "none")
    check_log(log, row, raised)


# --- gripper ----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Fault:
    """before: done before the cell is opened. provoke: raises, in an episode, with the gripper
    activated; nothing where opening raises."""

    before: Callable[[Bench], object] = lambda bench: None
    provoke: Callable[[Bench], object] = lambda bench: None


def move(bench: Bench) -> None:
    bench.gripper.move(0.0, speed=0.02, force=20.0)


def while_moving(act: Callable[[Bench], None]) -> Callable[[Bench], None]:
    """The deed happens when the fingers have travelled a millimetre."""

    def scenario(bench: Bench) -> None:
        sleep = bench.clock.sleep

        def watch(seconds: float) -> None:
            if bench.jaws.state().width < 0.084:
                bench.clock.sleep = sleep  # type: ignore[method-assign]
                act(bench)
            sleep(seconds)

        bench.clock.sleep = watch  # type: ignore[method-assign]
        move(bench)

    return scenario


def fails_with(code: FaultCode) -> Fault:
    return Fault(provoke=while_moving(lambda bench: bench.model.fail(code)))


def on_line(line: Callable[[bytes], tuple[float, bytes]]) -> Callable[[Bench], None]:
    def scenario(bench: Bench) -> None:
        bench.emulator.line = line
        bench.gripper.state()

    return scenario


def blink(bench: Bench) -> None:
    bench.model.cut_power()
    bench.model.restore_power()


def instead(wire: Callable[[Bench], RobotiqWire]) -> Callable[[Bench], None]:
    """Another wire."""

    def before(bench: Bench) -> None:
        bench.gripper = RobotiqGripper(wire(bench), clock=bench.clock)

    return before


def held_port(bench: Bench) -> RobotiqWire:
    port = bench.emulator.serve_pty()
    holder = serial_wire(port)
    holder.open()
    bench.exits.callback(holder.close)
    return serial_wire(port)


def wrong_unit(bench: Bench) -> RobotiqWire:
    host, port = bench.emulator.serve_rtu_over_tcp("127.0.0.1")
    return rtu_over_tcp_wire(host, port=port, unit_id=11)


def jammed(bench: Bench) -> None:
    blink(bench)
    bench.model.activation_blocked = True
    bench.gripper.activate(deadline=3.0)


def not_activated(bench: Bench) -> None:
    blink(bench)
    move(bench)


def refuse(bench: Bench) -> None:
    bench.emulator.refusing = True
    bench.gripper.state()


def too_slow(bench: Bench) -> None:
    bench.gripper.move(0.0, speed=0.02, force=20.0, deadline=0.5)


def gone(bench: Bench) -> None:
    bench.emulator.close()
    bench.gripper.state()


GRIPPER_FAULTS = {
    "no-serial-port": Fault(before=instead(lambda b: serial_wire("/dev/no-such-port"))),
    "serial-port-held": Fault(before=instead(held_port)),
    "unplugged-while-moving": Fault(provoke=while_moving(lambda b: b.emulator.close())),
    "no-server": Fault(before=instead(lambda b: rtu_over_tcp_wire("127.0.0.1", port=1))),
    "no-urcap": Fault(before=instead(lambda b: UrcapWire("127.0.0.1", port=1))),
    "server-gone": Fault(provoke=gone),
    "urcap-gone": Fault(provoke=gone),
    "mute": Fault(provoke=on_line(mute)),
    "mute-while-moving": Fault(provoke=while_moving(lambda b: setattr(b.emulator, "line", mute))),
    "mute-urcap": Fault(provoke=on_line(mute)),
    "bad-checksums": Fault(provoke=on_line(corrupt)),
    "always-late": Fault(provoke=on_line(late(0.25))),
    "wrong-unit": Fault(before=instead(wrong_unit)),
    "another-device": Fault(provoke=on_line(lambda _: (0.0, frame(9, 0x84, b"\x02")))),
    "arm-emergency-stopped": Fault(provoke=refuse),
    "power-lost-while-moving": Fault(provoke=while_moving(lambda b: b.model.cut_power())),
    "power-lost-behind-urcap": Fault(provoke=while_moving(lambda b: b.model.cut_power())),
    "power-blinked": Fault(provoke=while_moving(blink)),
    "not-activated": Fault(provoke=not_activated),
    "jammed-at-activation": Fault(provoke=jammed),
    "fingers-too-slow": Fault(provoke=too_slow),
    "overheated": fails_with(FaultCode.HOT),
    "undervoltage": fails_with(FaultCode.UNDERVOLTAGE),
    "automatic-release": Fault(provoke=while_moving(lambda b: b.model.release_automatically())),
    "internal-fault": fails_with(FaultCode.INTERNAL),
    "activation-failed": fails_with(FaultCode.ACTIVATION),
    "overcurrent": fails_with(FaultCode.OVERCURRENT),
}


def wires(row: Row) -> Sequence[str]:
    return WIRES if row.on == ("any",) else row.on


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.parametrize(
    ("name", "wire"),
    [
        pytest.param(name, wire, id=f"{name}-{wire}")
        for name in GRIPPER_FAULTS
        for wire in wires(table()[name])
    ],
)
def test_gripper(name: str, wire: str, arm: FakeArm, tmp_path: Path) -> None:
    fault = GRIPPER_FAULTS[name]
    with bench_on(wire) as bench, ExitStack() as open_cells:
        fault.before(bench)
        cell = Cell(
            config=config(),
            camera=StillCamera(bench.clock),
            arm=arm,
            gripper=bench.gripper,
            clock=bench.clock,
        )
        check(table()[name], cell, arm, lambda: fault.provoke(bench), tmp_path, open_cells)
        comes_to_rest(bench)


def comes_to_rest(bench: Bench) -> None:
    deadline = bench.clock.now() + 6.0
    while bench.jaws.state().moving:
        assert bench.clock.now() < deadline
        bench.clock.sleep(0.05)
    width = bench.jaws.state().width
    bench.clock.sleep(0.1)
    assert bench.jaws.state().width == width


# --- camera -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Eye:
    """A camera, and what makes it fail once it is connected; nothing where connecting does."""

    camera: RealsenseCamera
    act: Callable[[], object] = lambda: None


def eye(source: RealsenseSource | None = None, **fields: object) -> Eye:
    section = config().camera.model_copy(update=fields)
    return Eye(camera=RealsenseCamera(section, clock=MachineClock(), source=source, warm_up=0.0))


def captured(fault: CameraFault) -> Callable[[pytest.MonkeyPatch], Eye]:
    def make(_: pytest.MonkeyPatch) -> Eye:
        source = EmulatedD435(picture)
        camera = eye(source).camera

        def act() -> None:
            source.fault = fault
            camera.capture(deadline=0.5)

        return Eye(camera=camera, act=act)

    return make


def no_library(patch: pytest.MonkeyPatch) -> Eye:
    patch.setitem(sys.modules, "pyrealsense2", None)
    return eye()


def dead_at_start(patch: pytest.MonkeyPatch) -> Eye:
    patch.setattr(realsense, "FIRST_FRAME_LIMIT", 0.3)
    source = EmulatedD435(picture)
    source.fault = stalled
    return eye(source)


def unplugged(_: pytest.MonkeyPatch) -> Eye:
    source = EmulatedD435(picture)
    camera = eye(source).camera

    def act() -> None:
        source.unplug()
        camera.capture()

    return Eye(camera=camera, act=act)


def odd_distortion(patch: pytest.MonkeyPatch) -> Eye:
    fisheye = SimpleNamespace(model="distortion.ftheta", coeffs=[0.1, 0.0, 0.0, 0.0, 0.0])
    patch.setattr(realsense, "to_intrinsics", lambda _: to_intrinsics(fisheye))
    return eye(EmulatedD435(picture))


CAMERA_FAULTS: dict[str, Callable[[pytest.MonkeyPatch], Eye]] = {
    "no-camera": lambda _: eye(serial="000000000000"),
    "no-library": no_library,
    "another-camera": lambda _: eye(EmulatedD435(picture), serial="111"),
    "another-size": lambda _: eye(EmulatedD435(picture), width=1280),
    "dead-at-start": dead_at_start,
    "stalled": captured(stalled),
    "unplugged": unplugged,
    "stale": captured(stale(10.0)),
    "torn": captured(torn(0.2)),
    "depth-lost": captured(depth_lost),
    "blind": captured(holes(1.0)),
    "no-recording": lambda _: eye(recording="/nowhere/cell.db3"),
    "odd-distortion": odd_distortion,
}


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.parametrize("name", CAMERA_FAULTS)
def test_camera(name: str, arm: FakeArm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    it = CAMERA_FAULTS[name](monkeypatch)
    cell = Cell(
        config=config(),
        camera=it.camera,
        arm=arm,
        gripper=FakeGripper(arm.table),
        clock=MachineClock(),
    )
    with ExitStack() as open_cells:
        check(table()[name], cell, arm, it.act, tmp_path, open_cells)


def test_a_partly_blind_camera_still_serves() -> None:
    with emulated(Scene()) as (camera, source):
        source.fault = holes(0.5)
        assert camera.capture().serial == SERIAL
