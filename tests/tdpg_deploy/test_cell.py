from __future__ import annotations

import pytest
from kinematic_cell import FakeArm, FakeCamera, FakeGripper, Table, kinematic_cell, kinematic_config

from tdpg_deploy.cell import MachineClock, open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.errors import CameraError, DeviceUnreachable, GripperError

CONFIG = kinematic_config()


def test_devices_are_connected_inside_and_closed_outside() -> None:
    table = Table(CONFIG)
    arm, gripper, camera = FakeArm(table), FakeGripper(table), FakeCamera(table)

    def are_open() -> list[bool]:
        return [arm.open, gripper.open, camera.open]

    cell = kinematic_cell(table, arm=arm, gripper=gripper, camera=camera)
    assert are_open() == [False, False, False]
    with cell:
        assert are_open() == [True, True, True]
        assert arm.stops == 0
    assert arm.stops == 1
    assert are_open() == [False, False, False]


@pytest.mark.parametrize("error", [RuntimeError("bug"), KeyboardInterrupt(), SystemExit(3)])
def test_any_exit_stops_the_arm(error: BaseException) -> None:
    table = Table(CONFIG)
    arm = FakeArm(table)
    with pytest.raises(type(error)), kinematic_cell(table, arm=arm):
        raise error
    assert arm.stops == 1
    assert not arm.open


def test_one_device_that_does_not_close_does_not_keep_the_others_open() -> None:
    class Jammed(FakeGripper):
        def close(self) -> None:
            raise GripperError("jammed")

    table = Table(CONFIG)
    arm, camera = FakeArm(table), FakeCamera(table)
    with (
        pytest.raises(GripperError, match="jammed"),
        kinematic_cell(table, arm=arm, camera=camera, gripper=Jammed(table)),
    ):
        pass
    assert arm.stops == 1
    assert [device.open for device in (arm, camera)] == [False] * 2


def test_one_device_that_does_not_connect_closes_those_before() -> None:
    class Unplugged(FakeCamera):
        def connect(self) -> None:
            raise CameraError("no camera on USB")

    table = Table(CONFIG)
    arm = FakeArm(table)
    with (
        pytest.raises(CameraError, match="no camera"),
        kinematic_cell(table, arm=arm, camera=Unplugged(table)),
    ):
        pytest.fail("must not get here")
    assert not arm.open


def test_a_real_cell_without_its_robot_says_so() -> None:
    """127.0.0.9: an address of this machine where nothing listens."""
    config = load_cell(DEFAULT_CELL)
    config = config.model_copy(update={"arm": config.arm.model_copy(update={"host": "127.0.0.9"})})
    with pytest.raises(DeviceUnreachable, match=r"127\.0\.0\.9"), open_cell(config, real=True):
        pytest.fail("must not get here")


def test_machine_clock_only_grows() -> None:
    clock = MachineClock()
    before = clock.now()
    clock.sleep(0.001)
    assert clock.now() > before
