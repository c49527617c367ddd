"""Modbus RTU on the wire: what can go wrong between two answers."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator

import pytest
from robotiq_on_wires import Bench, emulated_gripper, wire_to

from tdpg_deploy.drivers.robotiq_registers import Command
from tdpg_deploy.drivers.robotiq_rtu import ModbusWire, rtu_over_tcp_wire, serial_wire
from tdpg_deploy.emulators.robotiq_modbus import frame
from tdpg_deploy.emulators.robotiq_wires import Line, corrupt, first, late, mute
from tdpg_deploy.errors import DeviceTimeout, DeviceUnreachable

SLOWER_THAN_PATIENCE = 0.25  # s


@pytest.fixture
def bench() -> Iterator[Bench]:
    with emulated_gripper() as bench:
        yield bench


@pytest.fixture(params=["serial", "rtu_over_tcp"])
def wire(bench: Bench, request: pytest.FixtureRequest) -> Iterator[ModbusWire]:
    wire = wire_to(bench.emulator, request.param)
    assert isinstance(wire, ModbusWire)
    wire.open()
    yield wire
    wire.close()


@pytest.mark.parametrize("glitch", [mute, corrupt], ids=["lost", "damaged"])
def test_a_single_bad_answer_is_asked_for_again(
    bench: Bench, wire: ModbusWire, glitch: Line
) -> None:
    bench.emulator.line = first(1, glitch)
    wire.write(Command(activate=True))
    bench.emulator.line = first(1, glitch)
    assert wire.read().activated


def test_a_late_answer_is_not_taken_for_that_to_the_next_request(
    bench: Bench, wire: ModbusWire
) -> None:
    bench.emulator.line = first(1, late(SLOWER_THAN_PATIENCE))
    wire.read()  # its first answer, "not activated", comes when the second has been asked for
    wire.write(Command(activate=True))
    assert wire.read().activated


def test_a_line_that_is_always_late_is_given_up(bench: Bench, wire: ModbusWire) -> None:
    bench.emulator.line = late(SLOWER_THAN_PATIENCE)
    with pytest.raises(DeviceTimeout, match="no valid answer from unit 9 in 3 attempts"):
        wire.read()


def test_a_refusal_is_told(bench: Bench, wire: ModbusWire) -> None:
    bench.emulator.line = lambda sent: (0.0, frame(9, 0x84, b"\x03"))
    with pytest.raises(DeviceTimeout, match=r"ExceptionResponse.*exception_code=3"):
        wire.read()


def test_an_answer_to_something_else_is_refused(bench: Bench, wire: ModbusWire) -> None:
    # The answer to FC 04 with 3 registers, as the manual prints it, to everything.
    bench.emulator.line = lambda sent: (0.0, bytes.fromhex("090406F90000000D0017AA"))
    assert wire.read().position == 13
    with pytest.raises(DeviceTimeout, match="no valid answer"):
        wire.write(Command(activate=True))
    bench.emulator.line = lambda sent: (0.0, frame(9, 4, bytes.fromhex("020000")))
    with pytest.raises(DeviceTimeout, match="status has 3 registers, got 1"):
        wire.read()


def test_a_foreign_unit_is_not_heard(bench: Bench) -> None:
    host, port = bench.emulator.serve_rtu_over_tcp("127.0.0.1")
    wire = rtu_over_tcp_wire(host, port=port, unit_id=3)
    wire.open()
    with pytest.raises(DeviceTimeout, match="from unit 3"):
        wire.read()
    wire.close()


def test_a_dropped_connection_is_opened_again(bench: Bench) -> None:
    wire = wire_to(bench.emulator, "rtu_over_tcp")
    wire.open()
    bench.emulator.hang_up()
    assert wire.read().position == 3
    wire.close()


def test_a_serial_port_says_why_it_does_not_open(
    monkeypatch: pytest.MonkeyPatch, bench: Bench
) -> None:
    with pytest.raises(DeviceUnreachable, match="there is no such port"):
        serial_wire("/dev/no-such-port").open()
    with pytest.raises(DeviceUnreachable, match="held by another program, or not a serial port"):
        serial_wire("/dev/null").open()
    port = bench.emulator.serve_pty()
    wire = serial_wire(port)
    wire.open()
    with pytest.raises(DeviceUnreachable, match="held by another program"):
        serial_wire(port).open()
    wire.close()
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(DeviceUnreachable, match="dialout"):
        serial_wire("/dev/null").open()


def test_without_pymodbus_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymodbus.client", None)
    with pytest.raises(DeviceUnreachable, match=r"pip install 'tdpg-deploy\[real\]'"):
        serial_wire("/dev/ttyUSB0").open()
