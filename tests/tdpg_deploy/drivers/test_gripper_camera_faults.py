"""Every row of docs/faults-gripper-camera.md, injected."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from emulated_d435 import INTRINSICS, SERIAL, Scene, emulated, section
from robotiq_on_wires import WIRES, Bench, bench_on

from tdpg_deploy import errors
from tdpg_deploy.cell import MachineClock
from tdpg_deploy.drivers.realsense import RealsenseCamera
from tdpg_deploy.drivers.realsense_frames import to_intrinsics
from tdpg_deploy.drivers.robotiq import RobotiqGripper
from tdpg_deploy.drivers.robotiq_rtu import rtu_over_tcp_wire, serial_wire
from tdpg_deploy.drivers.robotiq_urcap import UrcapWire
from tdpg_deploy.emulators.realsense import EmulatedD435, depth_lost, holes, stale, stalled, torn
from tdpg_deploy.emulators.robotiq import FaultCode
from tdpg_deploy.emulators.robotiq_modbus import frame
from tdpg_deploy.emulators.robotiq_wires import corrupt, late, mute

TABLE = Path(__file__).parents[3] / "docs" / "faults-gripper-camera.md"


@dataclass(frozen=True, kw_only=True)
class Row:
    fault: str
    wires: tuple[str, ...]
    raised: type[Exception]
    says: str


def rows(section: str) -> list[Row]:
    """The rows of one table of the page."""
    text = TABLE.read_text(encoding="utf-8").partition(f"## {section}\n")[2].partition("\n## ")[0]
    lines = [line.strip("| \n").split(" | ") for line in text.splitlines() if line[:2] == "| "]
    head, *body = lines
    found = []
    for cells in body:
        row = dict(zip(head, cells, strict=True))
        wires = row.get("on", "")
        found.append(
            Row(
                fault=row["fault"],
                wires=WIRES if wires == "any" else tuple(wires.split(", ")),
                raised=getattr(errors, row["raised"]),
                says=row["the message says"],
            )
        )
    return found


GRIPPER, CAMERA = rows("Gripper"), rows("Camera")


# --- gripper ----------------------------------------------------------------------------------


def move(bench: Bench) -> None:
    bench.gripper.move(0.0, speed=0.02, force=20.0)


def while_moving(act: Callable[[Bench], None]) -> Callable[[Bench], None]:
    """The deed happens when the fingers have travelled a millimetre."""

    def scenario(bench: Bench) -> None:
        bench.gripper.activate()
        sleep = bench.clock.sleep

        def watch(seconds: float) -> None:
            if bench.jaws.state().width < 0.084:
                bench.clock.sleep = sleep  # type: ignore[method-assign]
                act(bench)
            sleep(seconds)

        bench.clock.sleep = watch  # type: ignore[method-assign]
        move(bench)

    return scenario


def fails_with(code: FaultCode) -> Callable[[Bench], None]:
    return while_moving(lambda bench: bench.model.fail(code))


def on_line(line: Callable[[bytes], tuple[float, bytes]]) -> Callable[[Bench], None]:
    def scenario(bench: Bench) -> None:
        bench.emulator.line = line
        bench.gripper.state()

    return scenario


def blink(bench: Bench) -> None:
    bench.model.cut_power()
    bench.model.restore_power()


def instead(bench: Bench, wire: object) -> None:
    """Connect over another wire, and ask."""
    bench.gripper.close()
    bench.gripper = RobotiqGripper(wire, clock=bench.clock)  # type: ignore[arg-type]
    bench.gripper.connect()


def serial_port_held(bench: Bench) -> None:
    port = bench.emulator.serve_pty()
    holder = serial_wire(port)
    holder.open()
    try:
        instead(bench, serial_wire(port))
    finally:
        holder.close()


def wrong_unit(bench: Bench) -> None:
    host, port = bench.emulator.serve_rtu_over_tcp("127.0.0.1")
    instead(bench, rtu_over_tcp_wire(host, port=port, unit_id=11))


def jammed(bench: Bench) -> None:
    bench.model.activation_blocked = True
    bench.gripper.activate(deadline=3.0)


def refuse(bench: Bench) -> None:
    bench.emulator.refusing = True
    bench.gripper.state()


def too_slow(bench: Bench) -> None:
    bench.gripper.activate()
    bench.gripper.move(0.0, speed=0.02, force=20.0, deadline=0.5)


def gone(bench: Bench) -> None:
    bench.emulator.close()
    bench.gripper.state()


GRIPPER_SCENARIOS: dict[str, Callable[[Bench], None]] = {
    "no-serial-port": lambda b: instead(b, serial_wire("/dev/no-such-port")),
    "serial-port-held": serial_port_held,
    "unplugged-while-moving": while_moving(lambda b: b.emulator.close()),
    "no-server": lambda b: instead(b, rtu_over_tcp_wire("127.0.0.1", port=1)),
    "no-urcap": lambda b: instead(b, UrcapWire("127.0.0.1", port=1)),
    "server-gone": gone,
    "urcap-gone": gone,
    "mute": on_line(mute),
    "mute-while-moving": while_moving(lambda b: setattr(b.emulator, "line", mute)),
    "mute-urcap": on_line(mute),
    "bad-checksums": on_line(corrupt),
    "always-late": on_line(late(0.25)),
    "wrong-unit": wrong_unit,
    "another-device": on_line(lambda _: (0.0, frame(9, 0x84, b"\x02"))),
    "arm-emergency-stopped": refuse,
    "power-lost-while-moving": while_moving(lambda b: b.model.cut_power()),
    "power-lost-behind-urcap": while_moving(lambda b: b.model.cut_power()),
    "power-blinked": while_moving(blink),
    "not-activated": move,
    "jammed-at-activation": jammed,
    "too-slow": too_slow,
    "overheated": fails_with(FaultCode.HOT),
    "undervoltage": fails_with(FaultCode.UNDERVOLTAGE),
    "automatic-release": while_moving(lambda b: b.model.release_automatically()),
    "internal-fault": fails_with(FaultCode.INTERNAL),
    "activation-failed": fails_with(FaultCode.ACTIVATION),
    "overcurrent": fails_with(FaultCode.OVERCURRENT),
}


def test_the_table_and_the_gripper_scenarios_are_the_same() -> None:
    assert [row.fault for row in GRIPPER] == list(GRIPPER_SCENARIOS)


SLOW = ("mute-while-moving", "power-lost-while-moving")  # every attempt to stop it waits, too


@pytest.mark.parametrize(
    ("row", "wire"),
    [
        pytest.param(
            row,
            wire,
            id=f"{row.fault}-{wire}",
            marks=[pytest.mark.slow] if row.fault in SLOW else [],
        )
        for row in GRIPPER
        for wire in row.wires
    ],
)
def test_gripper(row: Row, wire: str) -> None:
    with bench_on(wire) as bench:
        bench.gripper.connect()
        with pytest.raises(row.raised) as raised:
            GRIPPER_SCENARIOS[row.fault](bench)
        assert type(raised.value) is row.raised
        assert row.says in str(raised.value)
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


def captured(fault: Callable[..., object]) -> Callable[[pytest.MonkeyPatch], None]:
    def scenario(_patch: pytest.MonkeyPatch) -> None:
        with emulated(Scene()) as (camera, source):
            source.fault = fault  # type: ignore[assignment]
            camera.capture(deadline=0.5)

    return scenario


def connected(**fields: object) -> None:
    camera = RealsenseCamera(section(**fields), clock=MachineClock())
    try:
        camera.connect()
    finally:
        camera.close()


def no_library(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(sys.modules, "pyrealsense2", None)
    connected()


def another_camera(_patch: pytest.MonkeyPatch) -> None:
    with emulated(Scene(), serial="111"):
        pass


def another_size(_patch: pytest.MonkeyPatch) -> None:
    with emulated(Scene(replace(INTRINSICS, width=320, height=240))):
        pass


def dead_at_start(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("tdpg_deploy.drivers.realsense.FIRST_FRAME_LIMIT", 0.3)
    source = EmulatedD435(Scene().frame)
    source.fault = stalled
    try:
        RealsenseCamera(section(), clock=MachineClock(), source=source).connect()
    finally:
        assert source.resets == 1


def unplugged(_patch: pytest.MonkeyPatch) -> None:
    with emulated(Scene()) as (camera, source):
        source.unplug()
        camera.capture()


def odd_distortion(_patch: pytest.MonkeyPatch) -> None:
    to_intrinsics(SimpleNamespace(model="distortion.ftheta", coeffs=[0.1, 0.0, 0.0, 0.0, 0.0]))


CAMERA_SCENARIOS: dict[str, Callable[[pytest.MonkeyPatch], None]] = {
    "no-camera": lambda _: connected(serial="000000000000"),
    "no-library": no_library,
    "another-camera": another_camera,
    "another-size": another_size,
    "dead-at-start": dead_at_start,
    "stalled": captured(stalled),
    "unplugged": unplugged,
    "stale": captured(stale(10.0)),
    "torn": captured(torn(0.2)),
    "depth-lost": captured(depth_lost),
    "blind": captured(holes(1.0)),
    "no-recording": lambda _: connected(recording="/nowhere/cell.db3"),
    "odd-distortion": odd_distortion,
}


def test_the_table_and_the_camera_scenarios_are_the_same() -> None:
    assert [row.fault for row in CAMERA] == list(CAMERA_SCENARIOS)
    assert len(GRIPPER) + len(CAMERA) >= 20


@pytest.mark.parametrize("row", CAMERA, ids=lambda row: row.fault)
def test_camera(row: Row, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(row.raised) as raised:
        CAMERA_SCENARIOS[row.fault](monkeypatch)
    assert type(raised.value) is row.raised
    assert row.says in str(raised.value)


def test_a_partly_blind_camera_still_serves() -> None:
    with emulated(Scene()) as (camera, source):
        source.fault = holes(0.5)
        assert camera.capture().serial == SERIAL
