"""What is in the way of grasping a goal: what may lie on it, then the least of what stands around,
by the goal's best direction."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from policies.closure import wedges
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
from policies.standing import Mask, within

_TIP = OPEN_GRIPPER[0]
_TIP_PIXELS = _TIP.along * _TIP.across / PIXEL**2
_TAKEN = (*OPEN_GRIPPER, Part(along=OPEN_WIDTH, across=PAD_WIDTH))  # and what is between the pads
SPECK = 0.05 * _TIP_PIXELS  # that noise at an outline may put under a finger tip
FIRM = np.radians(45)  # wedge between the faces of a goal that is firmly held
AS_GOOD = 0.1 * _TIP_PIXELS  # by which one grasp may be more hindered than the least
CLOSE = 0.012  # m from the goal within which something may lie on it: more than a shadow's edge ...
HIGHER = 0.015  # ... where it rises above the goal by this ...
LEAST = 1e-4  # ... over so many square metres
REACH = 0.03  # m from what hinders a goal's grasp within which it is grasped itself
BESIDE = 0.05  # m from the goal within which others may be pushed or lifted for its sake


def in_the_way(heightmap: Heightmap) -> Mask:
    """(224, 224): where something may be lifted for the goal's sake: what hinders a grasp of it;
    all beside it where nothing does, for then it is buried, or the ground around it is unseen."""
    assert heightmap.goal is not None
    hinders = hindering(heightmap)
    return within(REACH, hinders) if hinders.any() else within(BESIDE, heightmap.goal)


def hindering(heightmap: Heightmap) -> Mask:
    """(224, 224): what may lie on the goal. Where nothing does, what the gripper would land or
    close on, beside the goal, at those grasps of it that are hindered least. Nothing, where one has
    room, and where the goal could not be grasped if it stood alone. Of the ground nothing is asked.
    """
    assert heightmap.goal is not None
    height = np.nan_to_num(heightmap.height)
    goal = heightmap.goal & (height > FLAT)
    taken = np.zeros((SIZE, SIZE), np.bool_)
    if not goal.any():
        return taken
    top = np.median(height[goal])
    on_it = _may_lie_on(goal, height > top + HIGHER)
    if on_it.sum() * PIXEL**2 >= LEAST:
        return on_it
    grasps = _of_goal_alone(heightmap, goal)
    if not grasps.any():
        return taken
    lowest = max(top - MIN_GRASP_DEPTH, FLAT)
    others = [(height > lowest + part.rise) & ~goal for part in _TAKEN]
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


def _may_lie_on(goal: Mask, higher: Mask) -> Mask:
    """What is higher right beside the goal, without lone pixels. Seen from above there is no
    telling whether it stands there or lies on it; a push would bury the goal then."""
    beside = (within(CLOSE, goal) & ~goal & higher).astype(np.uint8)
    found: Mask = cv2.morphologyEx(beside, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    return found


def _of_goal_alone(heightmap: Heightmap, goal: Mask) -> Mask:
    """(8, 224, 224): grasps that would fit and hold firmly if nothing else stood on the table."""
    alone = np.where(goal, heightmap.height, np.float32(0))
    grasps = goal & (pixels_under(goal, _TIP) <= SPECK)
    held: Mask = wedges(replace(heightmap, height=alone, rim=None), grasps, 0.0) <= FIRM
    return held
