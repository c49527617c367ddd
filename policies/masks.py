"""Which actions are allowed: pure functions of the heightmap."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from policies.closure import MAX_WEDGE, SURE_WEDGE, wedges
from policies.fingers import Ground, under_open_gripper
from policies.gripper import have_room
from policies.heightmap import PIXEL, SIZE, Heightmap
from policies.hindering import in_the_way
from policies.policy import HALF_TURN, ROTATIONS, QMaps
from policies.primitives import Grasp, Primitive, Push
from policies.pushable import all_pushes, pushable
from policies.standing import Map, Mask, rising

NEAR = 0.010  # m; actions closer than this ...
NEAR_TURNS = 1  # ... and turned by no more than this many rotations count as the same


@dataclass(frozen=True, kw_only=True, eq=False)
class AllowedMaps(QMaps):
    """sure: (8, 224, 224) the grasps that surely hold what they close on."""

    sure: Mask


def allowed(
    maps: QMaps,
    heightmap: Heightmap,
    avoid: Sequence[Primitive] = (),
    *,
    promising: bool = True,
    wedged: bool = False,
) -> AllowedMaps:
    """The maps with -inf where no action is allowed, or one of `avoid` is near. promising: of
    pushes only the most promising kind that is left; else all of them. wedged: grasps that may
    squeeze out what they close on are allowed; else they are when nothing else is left."""
    ground = under_open_gripper(heightmap)
    grasp = np.where(graspable(heightmap, ground), maps.grasp, np.float32(-np.inf))
    for primitive in avoid:
        if isinstance(primitive, Grasp):
            rotation, row, col = _entry(primitive, heightmap)
            for side in (rotation, rotation + HALF_TURN):
                strike_out(grasp, side, row, col)
    pushes = [primitive for primitive in avoid if isinstance(primitive, Push)]
    push = _pushes(maps.push, heightmap, pushes, promising)
    half = wedges(heightmap, np.isfinite(grasp[:HALF_TURN]), ground.highest)
    held = np.where(np.concatenate((half, half)) <= MAX_WEDGE, grasp, np.float32(-np.inf))
    if not wedged and (np.isfinite(held).any() or np.isfinite(push).any()):
        grasp = held
    return AllowedMaps(push=push, grasp=grasp, sure=half <= SURE_WEDGE)


def graspable(heightmap: Heightmap, ground: Ground) -> Mask:
    """(16, 224, 224): a grasp closes on an object that was seen. Both fingers come down beside it
    on seen ground, and low enough; nothing of the gripper lands on what stands around. With a
    goal: on it or on what is in its way."""
    objects = rising(heightmap)
    if heightmap.goal is not None:
        objects &= heightmap.goal | in_the_way(heightmap)
    half = objects & ground.known & have_room(heightmap.height, ground.highest)
    return np.concatenate((half, half))


def sure_grasps(heightmap: Heightmap, on: Mask) -> Mask:
    """(8, 224, 224): grasps on any of the pixels `on` (224, 224) that surely hold what they close
    on."""
    ground = under_open_gripper(heightmap)
    grasps = graspable(heightmap, ground)[:HALF_TURN] & on
    sure: Mask = wedges(heightmap, grasps, ground.highest) <= SURE_WEDGE
    return sure


def _pushes(values: Map, heightmap: Heightmap, avoid: Sequence[Push], promising: bool) -> Map:
    """The values of the first kind of pushes of which any are left, or of all that are allowed."""
    left = np.full_like(values, -np.inf)
    if np.isneginf(values).all():
        return left  # a policy that does not push
    kinds: Iterable[Mask] = pushable(heightmap) if promising else [all_pushes(heightmap)]
    for mask in kinds:
        left = np.where(mask, values, np.float32(-np.inf))
        for push in avoid:
            strike_out(left, *_entry(push, heightmap))
        if np.isfinite(left).any():
            break
    return left


def _entry(primitive: Primitive, heightmap: Heightmap) -> tuple[int, int, int]:
    """Rotation, row and column of the maps."""
    row, col = heightmap.workspace.to_pixel(primitive.x, primitive.y)
    return round(primitive.yaw / (2 * np.pi / ROTATIONS)), int(row), int(col)


def strike_out(values: Map, rotation: int, row: int, col: int) -> None:
    """-inf at all actions NEAR to this one. The first axis of `values` is a full turn of it."""
    radius = round(NEAR / PIXEL)
    rows = slice(max(0, row - radius), max(0, row + radius + 1))
    cols = slice(max(0, col - radius), max(0, col + radius + 1))
    down = np.arange(SIZE)[rows, None] - row
    right = np.arange(SIZE)[cols] - col
    disc = down**2 + right**2 <= radius**2
    for turn in range(rotation - NEAR_TURNS, rotation + NEAR_TURNS + 1):
        values[turn % len(values), rows, cols][disc] = -np.inf
