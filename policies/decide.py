"""From the values of allowed actions to one action: pure functions of maps and generator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice, product
from typing import Literal

import numpy as np
import numpy.typing as npt

from policies.heightmap import Heightmap
from policies.masks import strike_out
from policies.policy import HALF_TURN, ROTATIONS, Choice, CriticVerdict, Decision, QMaps
from policies.primitives import Grasp, Primitive, Push
from policies.standing import Map, Mask

C = 0.6  # Critic II's threshold (paper, section III-D)
CONSIDERED = 10  # grasps that are fed into Critic II (paper, section III-B)

_MARGIN = {"grasp": 3, "push": 5}  # pixels around the action that its height is read from


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
    sure: Mask | None = None,
    count: int = CONSIDERED,
) -> tuple[Choice, ...]:
    """The `count` largest grasps, best first, no two of them NEAR each other: neighbouring
    pixels are the same grasp, and ten of those would be one opinion. goal (224, 224): so many on
    it, and after them so many beside it. sure (8, 224, 224): of each so many that surely hold,
    and after them so many of the others."""
    values = maps.grasp[:HALF_TURN]  # the other half repeats it
    everywhere = np.ones((1, 1), np.bool_)
    places = (everywhere,) if goal is None else (goal, ~goal)
    holds = (everywhere,) if sure is None else (sure, ~sure)
    return tuple(
        grasp
        for place, hold in product(places, holds)
        for grasp in islice(
            best_apart(np.where(place & hold, values, np.float32(-np.inf)), "grasp", rng), count
        )
    )


def best_apart(
    values: Map, kind: Literal["grasp", "push"], rng: np.random.Generator
) -> Iterator[Choice]:
    """One after the other, the best first, no two of them NEAR each other."""
    left = values.copy()
    while (choice := best(left, kind, rng)) is not None:
        yield choice
        strike_out(left, choice.rotation, choice.row, choice.col)


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
    the paper, whose rule looks for a better one among ten. Grasps: Critic I's best few that surely
    hold, then of the others; with a goal those on it, and after them those of what is in its way.
    Where no push is allowed, the surest of them is made.
    """
    sure = (grasp for grasp, p in zip(grasps, p_success, strict=True) if p >= least)
    return next(sure, grasps[int(np.argmax(p_success))] if push is None else push)


def choose_surest(
    _chosen: Choice,
    grasps: Sequence[Choice],
    push: Choice | None,
    p_success: npt.NDArray[np.float64],
    *,
    least: float,
) -> Choice:
    """The grasp to which Critic II gives most, if that is `least` or more, else the best push. For
    a Critic II that was taught by grasps that it was not sure of: any other is most wrong about
    the one that looks best. Where no push is allowed, the surest grasp is made.
    """
    surest = int(np.argmax(p_success))
    return grasps[surest] if push is None or p_success[surest] >= least else push


# --- from the map to the world ----------------------------------------------------------------


def surface(height: Map, row: int, col: int, margin: int) -> float:
    """Height (m) of the surface seen within `margin` pixels: its upper end without outliers."""
    window = height[
        max(0, row - margin) : row + margin + 1, max(0, col - margin) : col + margin + 1
    ]
    return float(np.nanquantile(window, 0.9))


def decided(
    choice: Choice,
    heightmap: Heightmap,
    maps: QMaps,
    *,
    verdict: CriticVerdict | None = None,
    considered: Sequence[Choice] = (),
    seconds: dict[str, float],
    p_foreseen: float | None = None,
) -> Decision:
    """To do what was chosen from these maps."""
    return Decision(
        primitive=to_primitive(choice, heightmap),
        rotation=choice.rotation,
        row=choice.row,
        col=choice.col,
        q=choice.q,
        maps=maps,
        verdict=verdict,
        considered=tuple(considered),
        seconds=seconds,
        p_foreseen=p_foreseen,
    )


def to_primitive(choice: Choice, heightmap: Heightmap) -> Primitive:
    """The action at the centre of the pixel, in base."""
    x, y = (float(value) for value in heightmap.workspace.to_base(choice.row, choice.col))
    above = surface(heightmap.height, choice.row, choice.col, _MARGIN[choice.kind])
    z = heightmap.workspace.table_z + above
    yaw = choice.rotation * 2 * np.pi / ROTATIONS
    if choice.kind == "grasp":
        return Grasp(x=x, y=y, z=z, yaw=yaw)
    return Push(x=x, y=y, z=z, yaw=yaw)
