"""Clients that others wrote against the emulated 2F-85: they know nothing of this project."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing

import pyrobotiqgripper
import pyrobotiqur
import pytest
import robotiq2f.robotiq2f as robotiq2f
from pyrobotiqur.enums import GripperStatus, ObjectStatus

from tdpg_deploy.emulators.robotiq import STROKE, KinematicJaws, RobotiqModel
from tdpg_deploy.emulators.robotiq_wires import RobotiqEmulator, late

FREE, AROUND_30_MM = (0.0, STROKE), (0.030, STROKE)
COUNTS_AT_30_MM = 149  # 228 - 225 * 30 / 85
SERIAL_LATENCY = 0.001  # s; an answer needs 5 ms at 115200 baud, and time runs eight times as fast


class Emulated(RobotiqEmulator):
    """Eight times as fast as the machine's time; `span` is what objects leave free."""

    def __init__(self) -> None:
        self.span = FREE
        jaws = KinematicJaws(self._now, span=lambda: self.span)
        super().__init__(RobotiqModel(jaws, self._now))
        self.line = late(SERIAL_LATENCY)

    @staticmethod
    def _now() -> float:
        return 8 * time.monotonic()


@pytest.fixture
def emulated() -> Iterator[Emulated]:
    with closing(Emulated()) as emulator:
        yield emulator


@pytest.fixture(params=["serial", "rtu_over_tcp"])
def rtu_client(
    emulated: Emulated, request: pytest.FixtureRequest
) -> Iterator[pyrobotiqgripper.RobotiqGripper]:
    if request.param == "serial":
        gripper = pyrobotiqgripper.RobotiqGripper(
            com_port=emulated.serve_pty(), connection_type=pyrobotiqgripper.GRIPPER_MODE_RTU
        )
    else:
        host, port = emulated.serve_rtu_over_tcp("127.0.0.1")
        gripper = pyrobotiqgripper.RobotiqGripper(
            connection_type=pyrobotiqgripper.GRIPPER_MODE_RTU_VIA_TCP, tcp_host=host, tcp_port=port
        )
    yield gripper
    gripper.disconnect()


def test_pyrobotiqgripper(emulated: Emulated, rtu_client: pyrobotiqgripper.RobotiqGripper) -> None:
    rtu_client.activate()
    assert rtu_client.isActivated()
    rtu_client.calibrate_mm(closemm=0, openmm=85)  # by travelling to both ends
    rtu_client.move(100)
    assert rtu_client.position() == 100
    emulated.span = AROUND_30_MM
    rtu_client.close()
    assert rtu_client.position() == COUNTS_AT_30_MM
    assert rtu_client.position_mm() == pytest.approx(30, abs=0.4)
    assert rtu_client.objectDetection() == 2


def test_robotiq2f(emulated: Emulated, monkeypatch: pytest.MonkeyPatch) -> None:
    port = emulated.serve_pty()
    monkeypatch.setattr(robotiq2f.LinuxFindTTYWithSerialNumber, "find", lambda *_: port)
    with robotiq2f.Robotiq2F85("any", async_control=False) as gripper:
        gripper.reset()
        assert gripper.is_activated
        emulated.span = AROUND_30_MM
        gripper.go_to(opening=0, speed=150, force=20)
        deadline = time.monotonic() + 5.0
        # It serves statuses of up to 5 ms ago: 40 ms of the emulated gripper.
        while not (status := gripper.read_status()).obj_detected:
            assert time.monotonic() < deadline, status
        assert status.opening == pytest.approx(30, abs=2)  # its scale ends at count 230
        assert status.goal_opening == 0


def test_pyrobotiqur(emulated: Emulated) -> None:
    host, port = emulated.serve_urcap("127.0.0.1")
    with pyrobotiqur.RobotiqGripper(host, port) as gripper:
        gripper.activate(poll_interval=0.01)
        assert gripper.get_status() is GripperStatus.ACTIVE
        assert gripper.move(100) == (100, ObjectStatus.AT_DEST)
        emulated.span = AROUND_30_MM
        assert gripper.close() == (COUNTS_AT_30_MM, ObjectStatus.STOPPED_INNER_OBJECT)
        assert gripper.get_fault() == 0
        emulated.refusing = True
        with pytest.raises(RuntimeError, match=r"replied '\?'"):
            gripper.set_var("POS", 0)
