"""All devices of a cell, one after the other; one that fails does not hide the next."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TypeAlias

from tdpg_deploy.cell import MachineClock, realsense_camera
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.doctor.finding import Finding, Verdict
from tdpg_deploy.errors import DeviceError

Examination: TypeAlias = Callable[[], Iterable[Finding]]


def examinations(config: CellConfig) -> dict[str, Examination]:
    """By device. None of these moves anything."""
    return {
        "arm": lambda: _arm(config),
        "gripper": lambda: _gripper(config),
        "camera": lambda: _camera(config),
    }


def motions(config: CellConfig) -> dict[str, Examination]:
    """By device. These move it, a little: see doctor.moves.PLAN."""
    return {"arm": lambda: _move_arm(config), "gripper": lambda: _move_gripper(config)}


def examine(examinations: Mapping[str, Examination]) -> Iterator[Finding]:
    """All findings; a device that cannot be examined any further is found bad."""
    for device, examination in examinations.items():
        yield from _to_its_end(device, examination)


def _to_its_end(device: str, examination: Examination) -> Iterator[Finding]:
    try:
        yield from examination()
    except DeviceError as error:  # its message says what to do, too
        yield Finding(device=device, check="responds", verdict=Verdict.BAD, measured=str(error))


def _arm(config: CellConfig) -> Iterable[Finding]:
    from tdpg_deploy.doctor.arm import examine_arm

    return examine_arm(config.arm)


def _gripper(config: CellConfig) -> Iterable[Finding]:
    from tdpg_deploy.doctor.gripper import examine_gripper
    from tdpg_deploy.drivers.robotiq import robotiq_gripper

    gripper = robotiq_gripper(config.gripper, arm_host=config.arm.host, clock=MachineClock())
    return examine_gripper(gripper, config.gripper)


def _move_arm(config: CellConfig) -> Iterable[Finding]:
    from tdpg_deploy.doctor.moves import move_arm
    from tdpg_deploy.drivers.ur5 import UrArm

    return move_arm(UrArm(config.arm, clock=MachineClock()), config)


def _move_gripper(config: CellConfig) -> Iterable[Finding]:
    from tdpg_deploy.doctor.moves import move_gripper
    from tdpg_deploy.drivers.robotiq import robotiq_gripper

    section = config.gripper
    # Asked for more than there is, the fingers stop at their own ends.
    beyond = section.model_copy(update={"open_counts": 0, "closed_counts": 255})
    gripper = robotiq_gripper(beyond, arm_host=config.arm.host, clock=MachineClock())
    return move_gripper(gripper, section)


def _camera(config: CellConfig) -> Iterable[Finding]:
    from tdpg_deploy.doctor.camera import examine_camera

    return examine_camera(realsense_camera(config.camera, clock=MachineClock()), config)
