"""Is the gripper there, sound, activated, and are its counts those of the cell file?"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from tdpg_deploy.cell_config import GripperSection
from tdpg_deploy.doctor.finding import Finding, judge
from tdpg_deploy.drivers.robotiq import RobotiqGripper
from tdpg_deploy.drivers.robotiq_registers import Fault, Status

GRIPPER = "gripper"
READS = 20
SLOW = 0.05  # s a status; a motion is watched by them


def examine_gripper(gripper: RobotiqGripper, section: GripperSection) -> Iterator[Finding]:
    """Findings, or DeviceError when it does not answer. Connects, reads, closes."""
    gripper.connect()
    try:
        times = []
        for _ in range(READS):
            began = time.perf_counter()
            status = gripper.status()
            times.append(time.perf_counter() - began)
    finally:
        gripper.close()
    yield _answers(gripper.name, float(np.median(times)))
    yield _fault(status)
    yield judge(
        GRIPPER,
        "activation",
        f"gSTA {status.activation.name}",
        good=status.is_ready,
        remedy="it will be activated by tdpg-run, and the fingers travel: keep clear",
    )
    yield _position(status, section)


def _answers(name: str, seconds: float) -> Finding:
    return judge(
        GRIPPER,
        "answers",
        f"{name}, {seconds * 1e3:.1f} ms a status",
        good=seconds < SLOW,
        remedy="a slow line: a USB converter's latency timer can be set to 1 ms",
    )


def _fault(status: Status) -> Finding:
    return judge(
        GRIPPER,
        "fault",
        f"gFLT 0x{status.fault:02X} {status.fault.name}",
        good=status.fault in (Fault.NONE, Fault.SILENCE),  # nobody spoke to it before us
        bad=status.fault.is_major or status.fault is Fault.OVERHEATED,
        remedy=status.fault.remedy,
    )


def _position(status: Status, section: GripperSection) -> Finding:
    inside = section.open_counts <= status.position <= section.closed_counts
    return judge(
        GRIPPER,
        "position",
        f"{status.position} counts",
        good=inside or not status.is_ready,
        remedy=(
            f"outside of gripper.open_counts = {section.open_counts} to gripper.closed_counts = "
            f"{section.closed_counts}: set them to what it reports fully open and fully closed"
        ),
    )
