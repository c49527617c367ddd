"""The register model alone, in a time that the test moves by hand."""

from __future__ import annotations

import pytest

from tdpg_deploy.drivers.robotiq_registers import Activation, Contact, Fault, Status, parse_status
from tdpg_deploy.emulators.robotiq import STROKE, FaultCode, KinematicJaws, RobotiqModel

ACTIVATE, MOVE = 0x0100, 0x0900


class Gripper:
    """A model with its time and its surroundings."""

    def __init__(self) -> None:
        self.time = 0.0
        self.span = (0.0, STROKE)
        self.jaws = KinematicJaws(lambda: self.time, span=lambda: self.span)
        self.model = RobotiqModel(self.jaws, lambda: self.time)

    def wait(self, seconds: float) -> Status:
        for _ in range(round(seconds / 0.005)):
            self.time += 0.005
            self.status()
        return self.status()

    def status(self) -> Status:
        return parse_status(self.model.read(2000, 3))

    def write(self, *words: int) -> None:
        self.model.write(1000, words)


@pytest.fixture
def fresh() -> Gripper:
    return Gripper()


@pytest.fixture
def active(fresh: Gripper) -> Gripper:
    fresh.write(ACTIVATE)
    assert fresh.wait(2.0).is_ready
    return fresh


def test_activation_closes_and_opens_in_the_time_that_it_takes(fresh: Gripper) -> None:
    fresh.write(ACTIVATE)
    assert fresh.wait(0.5).activation is Activation.IN_PROGRESS
    assert fresh.jaws.state().width == pytest.approx(STROKE - 0.5 * 0.150, abs=1e-3)
    assert fresh.wait(0.6).activation is Activation.IN_PROGRESS
    assert fresh.wait(0.1).activation is Activation.ACTIVE
    assert fresh.jaws.state().width == STROKE


def test_the_fingers_take_their_time(active: Gripper) -> None:
    active.write(MOVE, 228, 0x0000)
    assert active.wait(1.0).contact is Contact.MOVING
    assert active.jaws.state().width == pytest.approx(STROKE - 0.020, abs=2e-4)
    assert active.wait(3.3).contact is Contact.AT_REQUEST
    assert active.status().position == 228


@pytest.mark.parametrize(("count", "speed"), [(0, 0.020), (255, 0.150)])
def test_the_slowest_and_the_fastest(active: Gripper, count: int, speed: float) -> None:
    active.write(MOVE, 255, count << 8)
    active.wait(0.2)
    assert active.jaws.state().width == pytest.approx(STROKE - 0.2 * speed, abs=1e-4)


def test_the_echo_comes_after_the_request(active: Gripper) -> None:
    active.write(MOVE, 100, 0xFF00)
    assert active.status().echo == 0
    assert active.wait(0.010).echo == 100


def test_contacts_while_closing_and_opening(active: Gripper) -> None:
    active.span = (0.030, STROKE)
    active.write(MOVE, 255, 0xFF00)
    assert active.wait(1.0).contact is Contact.WHILE_CLOSING
    active.span = (0.030, 0.050)
    active.write(MOVE, 0, 0xFF00)
    assert active.wait(1.0).contact is Contact.WHILE_OPENING
    assert active.jaws.state().width == 0.050


def test_go_to_cleared_stops_the_fingers(active: Gripper) -> None:
    active.write(MOVE, 255, 0x0000)
    active.wait(0.5)
    active.write(ACTIVATE)
    width = active.jaws.state().width
    active.wait(0.5)
    assert active.jaws.state().width == width


def test_a_motion_asked_during_activation_is_delayed(fresh: Gripper) -> None:
    fresh.write(ACTIVATE)
    fresh.write(MOVE, 100, 0xFF00)
    assert fresh.wait(0.1).fault is Fault.ACTION_DELAYED
    status = fresh.wait(3.0)
    assert (status.fault, status.position) == (Fault.NONE, 100)


def test_a_motion_asked_without_activation_is_refused(fresh: Gripper) -> None:
    fresh.write(0x0800, 100, 0xFF00)
    assert fresh.wait(0.1).fault is Fault.NOT_ACTIVATED
    assert fresh.jaws.state().width == STROKE


@pytest.mark.parametrize("code", [FaultCode(c) for c in (0xA, 0xC, 0xD, 0xE)])
def test_major_faults_need_a_rising_edge(active: Gripper, code: FaultCode) -> None:
    active.model.fail(code)
    active.write(MOVE, 255, 0xFF00)
    assert active.wait(0.5).fault is Fault(code)
    assert active.jaws.state().width == STROKE
    active.write(0)
    active.write(ACTIVATE)
    assert active.wait(2.0).fault is Fault.NONE


def test_heat_goes_by_itself(active: Gripper) -> None:
    active.model.fail(FaultCode.HOT)
    active.write(MOVE, 255, 0xFF00)
    assert active.wait(0.5).fault is Fault.OVERHEATED
    active.model.cool_down()
    assert active.wait(0.1).fault is Fault.NONE


def test_automatic_release_opens_slowly_and_asks_for_activation(active: Gripper) -> None:
    active.write(MOVE, 228, 0xFF00)
    active.wait(1.0)
    active.write(0x1100)  # rATR
    assert active.wait(1.0).fault is Fault.AUTOMATIC_RELEASE
    assert active.wait(4.0).fault is Fault.AUTOMATIC_RELEASE_DONE
    assert active.jaws.state().width == STROKE


def test_a_second_of_silence_is_reported_once(active: Gripper) -> None:
    active.time += 1.5
    assert active.status().fault is Fault.SILENCE
    assert active.status().fault is Fault.NONE


def test_power_loss_forgets_everything(active: Gripper) -> None:
    active.write(MOVE, 228, 0x0000)
    active.wait(0.5)
    active.model.cut_power()
    active.model.restore_power()
    status = active.status()
    assert not status.activated
    assert status.activation is Activation.RESET
    assert 3 < status.position < 228  # the fingers stay where they were


def test_time_passes_without_anybody_asking(fresh: Gripper) -> None:
    fresh.write(ACTIVATE)
    for _ in range(400):
        fresh.time += 0.005
        fresh.model.advance()
    assert fresh.status().is_ready


def test_jammed_fingers_never_activate(fresh: Gripper) -> None:
    fresh.model.activation_blocked = True
    fresh.write(ACTIVATE)
    assert fresh.wait(10.0).activation is Activation.IN_PROGRESS
