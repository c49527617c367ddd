"""What stands in the way of grasping a goal: the least of it, by the goal's best direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from policies.closure import holding
from policies.fingers import pixels_under, under_any
from policies.gripper import (
    FLAT,
    MIN_GRASP_DEPTH,
    OPEN_GRIPPER,
    OPEN_WIDTH,
    PAD_WIDTH,
    Part,
)
from policies.heightmap import PIXEL, SIZE, Heightmap

_TIP = OPEN_GRIPPER[0]
_TIP_PIXELS = _TIP.along * _TIP.across / PIXEL**2
_TAKEN = (*OPEN_GRIPPER, Part(along=OPEN_WIDTH, across=PAD_WIDTH))  # and what is between the pads
SPECK = 0.05 * _TIP_PIXELS  # that noise at an outline may put under a finger tip
FIRM = np.radians(45)  # wedge between the faces of a goal that is firmly held
AS_GOOD = 0.1 * _TIP_PIXELS  # by which one grasp may be more hindered than the least

Mask = npt.NDArray[np.bool_]


def hindering(heightmap: Heightmap) -> Mask:
    """(224, 224): what the gripper would land or close on, beside the goal, at those grasps of it
    that are hindered least. Nothing, where one has room, and where the goal could not be grasped
    if it stood alone: it is buried or leans. Of the ground nothing is asked."""
    assert heightmap.goal is not None
    height = np.nan_to_num(heightmap.height)
    goal = heightmap.goal & (height > FLAT)
    lowest = np.median(height[goal]) - MIN_GRASP_DEPTH if goal.any() else 0.0
    others = [(height > max(lowest, FLAT) + part.rise) & ~goal for part in _TAKEN]
    grasps = _of_goal_alone(heightmap, goal)
    taken = np.zeros((SIZE, SIZE), np.bool_)
    if not grasps.any():
        return taken
    hindrance = np.zeros(grasps.shape, np.float32)
    for other, part in zip(others, _TAKEN, strict=True):
        hindrance += pixels_under(other, part)
    least = hindrance[grasps].min()
    if least <= SPECK:
        return taken
    easiest = grasps & (hindrance <= least + AS_GOOD)
    for other, part in zip(others, _TAKEN, strict=True):
        taken |= other & under_any(easiest, part)
    return taken


def _of_goal_alone(heightmap: Heightmap, goal: Mask) -> Mask:
    """(8, 224, 224): grasps that would fit and hold firmly if nothing else stood on the table."""
    alone = np.where(goal, heightmap.height, np.float32(0))
    grasps = goal & (pixels_under(goal, _TIP) <= SPECK)
    return holding(replace(heightmap, height=alone, rim=None), grasps, max_wedge=FIRM)
