"""From action values to one action: pure functions of maps, heightmap and generator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F

from policies.closure import holding
from policies.fingers import under_closed_gripper, under_open_gripper
from policies.gripper import have_room
from policies.heightmap import PIXEL, SIZE, Heightmap
from policies.policy import HALF_TURN, ROTATIONS, QMaps
from policies.primitives import PUSH_LENGTH, Grasp, Primitive, Push

C = 0.6  # Critic II's threshold (paper, section III-D)
CONSIDERED = 10  # grasps that are fed into Critic II (paper, section III-B)

RISE = 0.010  # m; what stands higher above the table is an object: four sigma of a D435 at 0.8 m
NEAR = 0.010  # m; actions closer than this ...
NEAR_TURNS = 1  # ... and turned by no more than this many rotations count as the same
PUSH_HALF_WIDTH = 0.006  # m; about half of the closed fingers' flat front: the rest slides along
PUSH_THROUGH = 0.03  # m at least that a push goes on from where it meets something
IN_THE_WAY = 0.05  # m from the goal within which others may be lifted or pushed for its sake
PUSH_MARGIN = 0.06  # m inside of the border that a push ends: what it shoves ahead stays inside
_MARGIN = {"grasp": 3, "push": 5}  # pixels around the action that its height is read from

Mask = npt.NDArray[np.bool_]
Map = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One entry of the Q-maps."""

    kind: Literal["grasp", "push"]
    rotation: int
    row: int
    col: int
    q: float


# --- which actions are allowed ----------------------------------------------------------------


def rising(heightmap: Heightmap) -> Mask:
    """(224, 224): pixels that were seen to stand above the table, lone specks left out.

    A pixel counts when five of the nine around it (itself one of them) rise by RISE.
    """
    with np.errstate(invalid="ignore"):
        high = heightmap.height > RISE
    padded = np.pad(high.astype(np.uint8), 1)
    votes = sum(padded[i : i + SIZE, j : j + SIZE] for i in range(3) for j in range(3))
    return high & (votes >= 5)


def _concerned(heightmap: Heightmap) -> Mask:
    """(224, 224): all objects; with a goal, it and what is near enough to be in its way."""
    objects = rising(heightmap)
    if heightmap.goal is None:
        return objects
    return objects & (_widest(heightmap.goal.astype(np.float32), round(IN_THE_WAY / PIXEL)) > 0)


def graspable(heightmap: Heightmap) -> Mask:
    """(16, 224, 224): a grasp closes on an object that was seen. Both fingers come down beside it
    on seen ground, and low enough; nothing of the gripper lands on what stands around. With a
    goal: on it or on what surrounds it."""
    ground = under_open_gripper(heightmap)
    half = _concerned(heightmap) & ground.known & have_room(heightmap.height, ground.highest)
    return np.concatenate((half, half))


def pushable(heightmap: Heightmap, *, length: float = PUSH_LENGTH) -> Mask:
    """(16, 224, 224): a push starts on seen ground, meets something that stands higher than its
    start by RISE, goes on from there by PUSH_THROUGH, and ends, after `length`, well inside of the
    workspace. With a goal: it meets the goal or what surrounds it."""
    ground = under_closed_gripper(heightmap)
    objects = np.where(_concerned(heightmap), heightmap.height, -np.inf).astype(np.float32)
    half_width = round(PUSH_HALF_WIDTH / PIXEL)
    swept = _widest(objects, half_width)
    reach, meets = length / PIXEL, (length - PUSH_THROUGH) / PIXEL
    steps = np.append(np.arange(half_width, meets, 2 * half_width), meets)
    side = np.arange(SIZE)
    masks = np.zeros((ROTATIONS, SIZE, SIZE), np.bool_)
    for rotation, mask in enumerate(masks):
        yaw = rotation * 2 * np.pi / ROTATIONS
        up, left = np.cos(yaw), np.sin(yaw)
        met = np.full((SIZE, SIZE), -np.inf, np.float32)
        for step in steps:
            _take_higher(met, swept, round(-step * up), round(-step * left))
        end_row, end_col = side - reach * up, side - reach * left
        ends_inside = _well_inside(end_row)[:, None] & _well_inside(end_col)
        higher = met > ground.highest[rotation % HALF_TURN] + RISE
        known = ground.known[rotation % HALF_TURN] & heightmap.valid
        np.logical_and(higher & known, ends_inside, out=mask)
    return masks


def _widest(height: Map, half_width: int) -> Map:
    """Maximum over squares of 2 * half_width + 1 pixels."""
    pooled = F.max_pool2d(
        torch.from_numpy(height)[None, None], 2 * half_width + 1, stride=1, padding=half_width
    )
    maximum: Map = pooled[0, 0].numpy()
    return maximum


def _take_higher(met: Map, height: Map, down: int, right: int) -> None:
    """met[r, c] = max(met[r, c], height[r + down, c + right]), where that exists."""
    to_rows, from_rows = _overlap(down)
    to_cols, from_cols = _overlap(right)
    target = met[to_rows, to_cols]
    np.maximum(target, height[from_rows, from_cols], out=target)


def _overlap(shift: int) -> tuple[slice, slice]:
    return slice(max(0, -shift), SIZE - max(0, shift)), slice(max(0, shift), SIZE + min(0, shift))


def _well_inside(pixels: npt.NDArray[np.float64]) -> Mask:
    margin = PUSH_MARGIN / PIXEL - 0.5
    return (pixels >= margin) & (pixels <= SIZE - 1 - margin)


def allowed(maps: QMaps, heightmap: Heightmap, avoid: Sequence[Primitive] = ()) -> QMaps:
    """The maps with -inf where no action is allowed, or one of `avoid` is near. Grasps that would
    squeeze out what they close on are allowed when nothing else is left."""
    grasp = np.where(graspable(heightmap), maps.grasp, np.float32(-np.inf))
    if np.isneginf(maps.push).all():
        push = maps.push.copy()
    else:
        push = np.where(pushable(heightmap), maps.push, np.float32(-np.inf))
    for primitive in avoid:
        row, col = heightmap.workspace.to_pixel(primitive.x, primitive.y)
        rotation = round(primitive.yaw / (2 * np.pi / ROTATIONS))
        if isinstance(primitive, Grasp):
            for side in (rotation, rotation + HALF_TURN):
                _strike_out(grasp, side, int(row), int(col))
        else:
            _strike_out(push, rotation, int(row), int(col))
    half = holding(heightmap, np.isfinite(grasp[:HALF_TURN]))
    held = np.where(np.concatenate((half, half)), grasp, np.float32(-np.inf))
    nothing_else = np.isneginf(held).all() and np.isneginf(push).all()
    return QMaps(push=push, grasp=grasp if nothing_else else held)


def _strike_out(values: Map, rotation: int, row: int, col: int) -> None:
    """-inf at all actions near to this one. The first axis of `values` is a full turn of it."""
    radius = round(NEAR / PIXEL)
    rows = slice(max(0, row - radius), max(0, row + radius + 1))
    cols = slice(max(0, col - radius), max(0, col + radius + 1))
    down = np.arange(SIZE)[rows, None] - row
    right = np.arange(SIZE)[cols] - col
    disc = down**2 + right**2 <= radius**2
    for turn in range(rotation - NEAR_TURNS, rotation + NEAR_TURNS + 1):
        values[turn % len(values), rows, cols][disc] = -np.inf


# --- which one is chosen ----------------------------------------------------------------------


def best(values: Map, kind: Literal["grasp", "push"], rng: np.random.Generator) -> Choice | None:
    """The highest value (k, 224, 224); `rng` decides between equals. None if all are -inf."""
    highest = values.max()
    if np.isneginf(highest):
        return None
    ties = np.flatnonzero(values == highest)
    place = np.unravel_index(ties[rng.integers(len(ties))], values.shape)
    rotation, row, col = (int(index) for index in place)
    return Choice(kind=kind, rotation=rotation, row=row, col=col, q=float(highest))


def best_push(maps: QMaps, rng: np.random.Generator) -> Choice | None:
    """argmax Q_push."""
    return best(maps.push, "push", rng)


def best_grasps(
    maps: QMaps,
    rng: np.random.Generator,
    *,
    goal: Mask | None = None,
    count: int = CONSIDERED,
) -> tuple[Choice, ...]:
    """The `count` largest grasps, best first, no two of them NEAR each other: neighbouring
    pixels are the same grasp, and ten of those would be one opinion. goal (224, 224): so many on
    it, and after them so many beside it."""
    values = maps.grasp[:HALF_TURN]  # the other half repeats it
    if goal is None:
        return tuple(_best_apart(values, rng, count))
    nothing = np.float32(-np.inf)
    on, beside = np.where(goal, values, nothing), np.where(goal, nothing, values)
    return (*_best_apart(on, rng, count), *_best_apart(beside, rng, count))


def _best_apart(values: Map, rng: np.random.Generator, count: int) -> Iterator[Choice]:
    left = values.copy()
    for _ in range(count):
        grasp = best(left, "grasp", rng)
        if grasp is None:
            return
        yield grasp
        _strike_out(left, grasp.rotation, grasp.row, grasp.col)


def choose_by_critic_one(grasps: Sequence[Choice], push: Choice | None) -> Choice | None:
    """argmax over both maps (paper, section III-A; VPG). A tie goes to the grasp."""
    if not grasps:
        return push
    return grasps[0] if push is None or grasps[0].q >= push.q else push


def choose_by_critic_two(
    chosen: Choice,
    grasps: Sequence[Choice],
    push: Choice | None,
    p_success: npt.NDArray[np.float64],
    *,
    c: float = C,
) -> Choice:
    """Critic II's rule (paper, eq. 2 and section III-B). grasps: best first, with p_success.

    A chosen grasp gives way to the best push if and only if 1 - P_success > c for all ten:
    that is how ten grasps see to it "that the grasping action will not be easily replaced".
    Else the first of the ten that is not doubted is made. A chosen push gives way to the first
    of the ten with P_success > c.
    """
    if chosen.kind == "grasp":
        trusted = (grasp for grasp, p in zip(grasps, p_success, strict=True) if not 1 - p > c)
        return next(trusted, chosen if push is None else push)
    promising = (grasp for grasp, p in zip(grasps, p_success, strict=True) if p > c)
    return next(promising, chosen)


def choose_if_sure(
    _chosen: Choice,
    grasps: Sequence[Choice],
    push: Choice | None,
    p_success: npt.NDArray[np.float64],
    *,
    least: float,
) -> Choice:
    """The first of the grasps to which Critic II gives `least` or more, else the best push. Not of
    the paper, whose rule looks for a better one among ten: the one of ten that looks best is the
    one that Critic II is most likely to be wrong about. So it is asked about Critic I's best, or
    with a goal about the best on the goal, and then about the best of what is in its way.
    """
    sure = (grasp for grasp, p in zip(grasps, p_success, strict=True) if p >= least)
    return next(sure, grasps[0] if push is None else push)


# --- from the map to the world ----------------------------------------------------------------


def surface(height: Map, row: int, col: int, margin: int) -> float:
    """Height (m) of the surface seen within `margin` pixels: its upper end without outliers."""
    window = height[
        max(0, row - margin) : row + margin + 1, max(0, col - margin) : col + margin + 1
    ]
    return float(np.nanquantile(window, 0.9))


def to_primitive(choice: Choice, heightmap: Heightmap) -> Primitive:
    """The action at the centre of the pixel, in base."""
    x, y = (float(value) for value in heightmap.workspace.to_base(choice.row, choice.col))
    above = surface(heightmap.height, choice.row, choice.col, _MARGIN[choice.kind])
    z = heightmap.workspace.table_z + above
    yaw = choice.rotation * 2 * np.pi / ROTATIONS
    if choice.kind == "grasp":
        return Grasp(x=x, y=y, z=z, yaw=yaw)
    return Push(x=x, y=y, z=z, yaw=yaw)
