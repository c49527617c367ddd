"""What the link and its child do beyond the fault table, on an emulated controller."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from ur_rig import PacedClock, arm_section, emulated_controller, new_host

from tdpg_deploy.drivers.ur5 import UrArm
from tdpg_deploy.drivers.ur5_control import ControlProcess
from tdpg_deploy.drivers.ur5_link import UrLink
from tdpg_deploy.drivers.ur5_status import ProgramStopped
from tdpg_deploy.emulators.ur_controller.process import ControllerProcess
from tdpg_deploy.errors import ArmError, DeviceTimeout
from tdpg_deploy.hal import ArmState

PACE = 4.0
pytestmark = pytest.mark.real_time


@pytest.fixture(scope="module")
def controller() -> Iterator[tuple[str, ControllerProcess]]:
    host = new_host()
    with emulated_controller(host, pace=PACE) as robot:
        yield host, robot


@pytest.fixture
def link(controller: tuple[str, ControllerProcess]) -> Iterator[UrLink]:
    host, robot = controller
    robot.do("reset")
    link = UrLink(host, clock=PacedClock(PACE))
    link.open()
    yield link
    link.close()


def test_answer_of_an_interrupted_call_is_passed_over(
    controller: tuple[str, ControllerProcess],
) -> None:
    host, robot = controller
    robot.do("reset")
    control = ControlProcess(host)
    control.start(deadline=15.0)
    assert control._connection is not None
    control._connection.send((99, "move_joints", ()))  # Ctrl-C came before its answer
    assert control.call("sample").robot_mode == 7
    control.kill()
    control.kill()


def test_set_up_that_is_not_taken(controller: tuple[str, ControllerProcess], link: UrLink) -> None:
    controller[1].do("stop_program")
    with pytest.raises(ProgramStopped, match="TCP, payload and watchdog were not accepted"):
        link.set_up((0.0,) * 6, 1.0, (0.0, 0.0, 0.0))


def test_waiting_for_rest_has_an_end(link: UrLink) -> None:
    q = link.sample().q
    link.start("move_joints", (q[0] + 0.5, *q[1:]), 0.5, 5.0)
    while max(map(abs, link.sample().qd)) < 0.2:
        pass
    with pytest.raises(DeviceTimeout, match="did not come to rest"):
        link.at_rest(until=0.0)
    assert max(map(abs, link.brake(10.0).qd)) < 0.01


def test_motion_that_ends_short_without_a_cause(
    controller: tuple[str, ControllerProcess],
) -> None:
    host, robot = controller
    robot.do("reset")
    arm = UrArm(arm_section(host), clock=PacedClock(PACE))
    arm.connect()
    assert str(arm.version) == "3.15.8.106339"
    start = arm.state().q

    def brake(state: ArmState) -> None:
        if np.abs(state.qd).max() > 0.2:
            arm._link.brake(10.0)

    with pytest.raises(ArmError, match="no cause is reported at the end of a motion that fell"):
        arm.move_joints(
            start + np.array([0.5, 0, 0, 0, 0, 0]),
            speed=0.5,
            acceleration=5.0,
            deadline=20.0,
            on_state=brake,
        )
    arm.close()
