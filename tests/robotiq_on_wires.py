"""An emulated 2F-85 behind each of its wires, for the tests of driver and emulator."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from ur_rig import PacedClock

from tdpg_deploy.drivers.robotiq import RobotiqGripper, RobotiqWire
from tdpg_deploy.drivers.robotiq_rtu import rtu_over_tcp_wire, serial_wire
from tdpg_deploy.drivers.robotiq_urcap import UrcapWire
from tdpg_deploy.emulators.robotiq import STROKE, KinematicJaws, RobotiqModel
from tdpg_deploy.emulators.robotiq_wires import RobotiqEmulator

PACE = 8.0  # times as fast as the machine: the fingers travel 85 mm in 0.1 s
WIRES = ("serial", "rtu_over_tcp", "urcap")


class Bench:
    """A gripper on a table, its emulator, and what objects leave free between its pads.
    exits: what is to be closed with it."""

    def __init__(self) -> None:
        self.span = (0.0, STROKE)
        self.exits = ExitStack()
        self.clock = PacedClock(PACE)
        self.jaws = KinematicJaws(self.clock.now, span=lambda: self.span)
        self.emulator = RobotiqEmulator(RobotiqModel(self.jaws, self.clock.now))
        self.gripper = RobotiqGripper(UrcapWire("127.0.0.1", port=1), clock=self.clock)

    @property
    def model(self) -> RobotiqModel:
        return self.emulator.model


@contextmanager
def emulated_gripper() -> Iterator[Bench]:
    """The emulator alone, with no wire yet: `gripper` cannot be connected."""
    bench = Bench()
    with bench.emulator, bench.exits:
        yield bench


@contextmanager
def bench_on(wire: str) -> Iterator[Bench]:
    """A gripper driver that is connected through one of WIRES."""
    with emulated_gripper() as bench:
        bench.gripper = RobotiqGripper(wire_to(bench.emulator, wire), clock=bench.clock)
        try:
            yield bench
        finally:
            bench.gripper.close()


def wire_to(emulator: RobotiqEmulator, wire: str) -> RobotiqWire:
    if wire == "serial":
        return serial_wire(emulator.serve_pty())
    if wire == "rtu_over_tcp":
        host, port = emulator.serve_rtu_over_tcp("127.0.0.1")
        return rtu_over_tcp_wire(host, port=port)
    host, port = emulator.serve_urcap("127.0.0.1")
    return UrcapWire(host, port=port)
