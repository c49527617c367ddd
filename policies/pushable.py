"""Which pushes are allowed, one kind after the other: pure functions of the heightmap."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from policies.fingers import under_closed_gripper
from policies.heightmap import PIXEL, SIZE, Heightmap
from policies.hindering import BESIDE
from policies.policy import ROTATIONS
from policies.primitives import PUSH_LENGTH
from policies.standing import RISE, Map, Mask, rising, widest, within

PUSH_HALF_WIDTH = 0.006  # m; about half of the closed fingers' flat front: the rest slides along
PUSH_THROUGH = 0.11  # m that a push goes on from where it meets something, if one can ...
PUSH_AT_LEAST = 0.03  # ... and that it goes on at least
MIDDLE = 0.8  # of how far the best push halves a pile, that is near enough to its middle
GOAL_THROUGH = 0.06  # m that it goes on over where the goal lies
BEYOND = 0.05  # m that are free beyond the end of a push that has the goal alone slide out
PUSH_MARGIN = 0.06  # m inside of the border that a push ends: what it shoves ahead stays inside
GOAL_MARGIN = 0.03  # m inside of it that the goal's middle stays, pushed as far as that
_HALF_WIDTH = round(PUSH_HALF_WIDTH / PIXEL)


def pushable(heightmap: Heightmap) -> Iterator[Mask]:
    """Masks (16, 224, 224) of one kind of pushes after the other, the most promising first. All
    start on seen ground, meet something that stands higher than their start by RISE, go on from
    there, and end, after PUSH_LENGTH, well inside of the workspace.

    With a goal: those that have it slide out alone from what it stands beside; those that meet it
    or what is beside it and go on over where it lies. Without one: those that go through the
    middle of a pile, which frees the most of it. Then, for both, those that go on for long: a grasp
    followed 178 of 180 that went on by 80 mm or more, and 148 of 175 others. The last kind
    is all of them.
    """
    objects, beside, meets = _pushes_at(heightmap)
    if heightmap.goal is not None:
        goal = objects & heightmap.goal
        over_goal = meets(goal, GOAL_THROUGH)
        yield over_goal & np.isneginf(_met(heightmap, objects & ~goal, PUSH_LENGTH + BEYOND))
        yield over_goal & meets(beside, PUSH_THROUGH)
        yield over_goal
    for_long = meets(beside, PUSH_THROUGH)
    if heightmap.goal is None:
        halved = np.where(for_long, _halved(objects, PUSH_LENGTH - PUSH_THROUGH), np.float32(0))
        yield for_long & (halved >= MIDDLE * halved.max())
    yield for_long
    yield meets(beside, PUSH_AT_LEAST)


def all_pushes(heightmap: Heightmap) -> Mask:
    """The last kind alone (16, 224, 224): all of them."""
    _, beside, meets = _pushes_at(heightmap)
    return meets(beside, PUSH_AT_LEAST)


def _pushes_at(heightmap: Heightmap) -> tuple[Mask, Mask, Callable[[Mask, float], Mask]]:
    """What stands there; what of it is to be pushed (224, 224); and which pushes meet such things
    and go on by so many metres."""
    ground = under_closed_gripper(heightmap)
    lowest = np.concatenate((ground.highest, ground.highest)) + np.float32(RISE)
    known = np.concatenate((ground.known, ground.known))
    starts = known & heightmap.valid & _ends_inside()
    if heightmap.goal is not None:
        starts &= _keeps_inside(heightmap.goal)[:, None, None]
    objects = rising(heightmap)
    beside = objects if heightmap.goal is None else objects & within(BESIDE, heightmap.goal)

    def meets(what: Mask, through: float) -> Mask:
        met: Mask = starts & (_met(heightmap, what, PUSH_LENGTH - through) > lowest)
        return met

    return objects, beside, meets


def _keeps_inside(goal: Mask) -> npt.NDArray[np.bool_]:
    """(16,): pushes in that direction leave the goal in the workspace, however much of what they
    shove ahead stands between the fingers and it."""
    if not goal.any():
        return np.ones(ROTATIONS, np.bool_)
    row, col = (at.mean() for at in np.nonzero(goal))
    margin = GOAL_MARGIN / PIXEL
    return np.array(
        [
            _inside(row, up, margin) & _inside(col, left, margin)
            for up, left in map(_ahead, range(ROTATIONS))
        ]
    )


def _met(heightmap: Heightmap, objects: Mask, until: float) -> Map:
    """(16, 224, 224) metres above the table: the highest of the objects that the middle of the
    fingers meets within `until` metres from each pixel; -inf where there is none."""
    height = np.where(objects, heightmap.height, np.float32(-np.inf))
    return _on_the_way([widest(height, _HALF_WIDTH)] * ROTATIONS, until)


def _halved(objects: Mask, until: float) -> Map:
    """(16, 224, 224) metres: how far the pile that a push meets within `until` metres, all that
    hangs together in the picture, reaches to that side of it where there is less."""
    count, pile = cv2.connectedComponents(objects.astype(np.uint8))
    rows, cols = np.nonzero(objects)
    of = pile[rows, cols].astype(np.intp)
    sides = np.zeros((ROTATIONS, SIZE, SIZE), np.float32)
    for rotation, side in enumerate(sides):
        up, left = _ahead(rotation)
        across = rows * left - cols * up
        first, last = np.full(count, np.inf), np.full(count, -np.inf)
        np.minimum.at(first, of, across)
        np.maximum.at(last, of, across)
        side[rows, cols] = np.minimum(across - first[of], last[of] - across) * PIXEL
    return _on_the_way((widest(side, _HALF_WIDTH) for side in sides), until)


def _on_the_way(values: Iterable[Map], until: float) -> Map:
    """(16, 224, 224): the highest of a rotation's values (224, 224), each as wide as the middle of
    the fingers, that lies within `until` metres ahead of each pixel."""
    end = until / PIXEL
    steps = np.append(np.arange(_HALF_WIDTH, end, 2 * _HALF_WIDTH), end)
    met = np.full((ROTATIONS, SIZE, SIZE), -np.inf, np.float32)
    for rotation, (at_each, value) in enumerate(zip(met, values, strict=True)):
        up, left = _ahead(rotation)
        for step in steps:
            _take_higher(at_each, value, round(-step * up), round(-step * left))
    return met


def _ahead(rotation: int) -> tuple[float, float]:
    """Pixels up and to the left of a step of one pixel."""
    yaw = rotation * 2 * np.pi / ROTATIONS
    return float(np.cos(yaw)), float(np.sin(yaw))


@cache
def _ends_inside() -> Mask:
    """(16, 224, 224): a push from there ends PUSH_MARGIN inside of the border or further."""
    margin, side = PUSH_MARGIN / PIXEL - 0.5, np.arange(SIZE)
    inside = np.empty((ROTATIONS, SIZE, SIZE), np.bool_)
    for rotation in range(ROTATIONS):
        up, left = _ahead(rotation)
        inside[rotation] = _inside(side, up, margin)[:, None] & _inside(side, left, margin)
    return inside


def _inside(at: npt.NDArray[np.intp] | float, step: float, margin: float) -> Mask:
    """Whether rows or columns, moved by a push of so many pixels a pixel, end in the map, `margin`
    pixels from its border."""
    end = np.asarray(at - PUSH_LENGTH / PIXEL * step)
    inside: Mask = (end >= margin) & (end <= SIZE - 1 - margin)
    return inside


def _take_higher(met: Map, height: Map, down: int, right: int) -> None:
    """met[r, c] = max(met[r, c], height[r + down, c + right]), where that exists."""
    to_rows, from_rows = _overlap(down)
    to_cols, from_cols = _overlap(right)
    target = met[to_rows, to_cols]
    np.maximum(target, height[from_rows, from_cols], out=target)


def _overlap(shift: int) -> tuple[slice, slice]:
    return slice(max(0, -shift), SIZE - max(0, shift)), slice(max(0, shift), SIZE + min(0, shift))
