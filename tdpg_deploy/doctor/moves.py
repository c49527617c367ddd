"""Small motions, asked for by name: does the arm follow, and where do the fingers end?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tdpg_deploy.cell_config import CellConfig, GripperSection
from tdpg_deploy.doctor.finding import Finding, judge
from tdpg_deploy.drivers.robotiq import RobotiqGripper
from tdpg_deploy.hal import Arm

PLAN = (
    "The last wrist joint turns by 5 degrees and back. Then the gripper is activated, closes and "
    "opens fully: take out what is between the fingers, and keep clear."
)
TURN = np.radians(5.0)
ARRIVED = np.radians(0.3)
SLOWLY = 0.1  # of the cell file's limits
COUNTS_APART = 2
DEADLINE = 15.0  # s


def move_arm(arm: Arm, config: CellConfig) -> Iterator[Finding]:
    """Turn wrist 3 there and back. Raises DeviceError with the arm stopped."""
    arm.connect()
    try:
        start = arm.state().q
        error = 0.0
        for q in (start + np.array([0, 0, 0, 0, 0, TURN]), start):
            result = arm.move_joints(
                q,
                speed=SLOWLY * config.limits.joint_speed,
                acceleration=SLOWLY * config.limits.joint_acceleration,
                deadline=DEADLINE,
            )
            error = max(error, float(np.abs(result.state.q - q).max()))
    finally:
        arm.stop()
        arm.close()
    yield judge(
        "arm",
        "small motion",
        f"arrived within {np.degrees(error):.2f} degrees",
        good=error <= ARRIVED,
        bad=True,
        remedy="the arm does not go where it is told: check its payload and its load",
    )


def move_gripper(gripper: RobotiqGripper, section: GripperSection) -> Iterator[Finding]:
    """Close and open fully, and tell the counts at both ends. Raises DeviceError."""
    gripper.connect()
    try:
        gripper.activate()
        ends = {}
        for end, width in (("closed", 0.0), ("open", gripper.max_width)):
            gripper.move(width, speed=section.speed, force=section.force)
            ends[end] = gripper.status().position
    finally:
        gripper.close()
    for end, expected in (("closed", section.closed_counts), ("open", section.open_counts)):
        yield judge(
            "gripper",
            f"{end} counts",
            str(ends[end]),
            good=abs(ends[end] - expected) <= COUNTS_APART,
            remedy=f"set gripper.{end}_counts = {ends[end]} (now {expected})",
        )
