"""Tables of tight clusters: blocks that stand face to face, as no heap falls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from scipy.spatial.transform import Rotation

from policies.heightmap import Workspace
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.sim.bodies import SHAPES, Shape
from tdpg_deploy.sim.scenes import PALETTE, SPAWN_MARGIN, Scene, SceneObject

CLUSTERS = (1, 1, 1, 2, 3)  # on one table, by equal chance
ALONE = (2, 9)  # objects of a cluster that has the table to itself, at least and at most ...
BESIDE_OTHERS = (2, 4)  # ... and of one that has not
CROWD = (5, 9)  # of a compact one
KINDS = (1, 3)  # of objects in one cluster
STACKED = 0.12  # share that is put on top of another
GAP = (0.0003, 0.002)  # m between neighbours; a finger is 18 mm thick
ACROSS = 0.24  # m that a cluster measures at most, each way
APART = 0.005  # m between clusters
TRIES = 50
CHOSEN_FROM = 8  # places for an object of a compact cluster
_TOUCHING = 1e-4  # m by which boxes may overlap


@dataclass(frozen=True, kw_only=True)
class _Placed:
    """An object in its cluster: the box around it, low and high corners (3,), above the table."""

    shape: Shape
    turn: Rotation
    low: Array
    high: Array

    @property
    def stands(self) -> bool:
        return bool(self.low[2] == 0)


def clustered_scene(
    workspace: Workspace,
    rng: np.random.Generator,
    shapes: Mapping[str, Shape] = SHAPES,
    *,
    compact: bool = False,
) -> Scene:
    """One to three clusters somewhere on the table, each turned somehow. A cluster grows object by
    object: each is put beside one that stands there already, flush with it, in its middle or
    anywhere along it; or on top of it. compact: one cluster of many, each put where that keeps it
    small, so that what stands in the middle is hemmed in."""
    count = 1 if compact else int(rng.choice(CLUSTERS))
    size = CROWD if compact else ALONE if count == 1 else BESIDE_OTHERS
    taken: list[tuple[Array, float]] = []  # middles, and radii around them
    objects: list[SceneObject] = []
    first = int(rng.integers(len(PALETTE)))
    for _ in range(count):
        cluster = _cluster(rng, shapes, size, CHOSEN_FROM if compact else 1)
        low = np.min([item.low for item in cluster], axis=0)[:2]
        high = np.max([item.high for item in cluster], axis=0)[:2]
        radius = float(np.hypot(*(high - low))) / 2
        middle = _room(radius, taken, workspace, rng)
        if middle is None:
            continue
        taken.append((middle, radius))
        whole = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
        for item in cluster:
            vertices = item.turn.apply(item.shape.vertices)
            offset = item.low - vertices.min(axis=0) - [*(low + high) / 2, 0.0]
            base = np.array([*middle, workspace.table_z])
            objects.append(
                SceneObject(
                    shape=item.shape,
                    X_base_object=Transform(whole * item.turn, base + whole.apply(offset)),
                    rgb=PALETTE[(first + len(objects)) % len(PALETTE)],
                )
            )
    return Scene(objects=tuple(objects))


def _cluster(
    rng: np.random.Generator, shapes: Mapping[str, Shape], size: tuple[int, int], chosen_from: int
) -> list[_Placed]:
    names = rng.choice(sorted(shapes), rng.integers(KINDS[0], KINDS[1] + 1))
    kinds = [shapes[name] for name in names]
    cluster: list[_Placed] = []
    for _ in range(int(rng.integers(size[0], size[1] + 1))):
        places = islice(_places(cluster, kinds, rng), chosen_from)
        placed = min(places, key=lambda place: _volume((*cluster, place)), default=None)
        if placed is not None:
            cluster.append(placed)
    return cluster


def _places(
    cluster: Sequence[_Placed], kinds: Sequence[Shape], rng: np.random.Generator
) -> Iterator[_Placed]:
    """Where one more of these shapes fits, at random."""
    for _ in range(TRIES):
        shape = kinds[int(rng.integers(len(kinds)))]
        turn = Rotation.from_euler("z", np.pi / 2 * rng.integers(2))
        sides = np.ptp(turn.apply(shape.vertices), axis=0)
        low = _beside_or_on(cluster, sides, rng)
        if low is None:
            continue
        placed = _Placed(shape=shape, turn=turn, low=low, high=low + sides)
        if _fits(placed, cluster):
            yield placed


def _volume(cluster: Sequence[_Placed]) -> float:
    """m^3 of the box around it."""
    lows, highs = ([getattr(item, end) for item in cluster] for end in ("low", "high"))
    return float(np.prod(np.max(highs, axis=0) - np.min(lows, axis=0)))


def _beside_or_on(
    cluster: Sequence[_Placed], sides: Array, rng: np.random.Generator
) -> Array | None:
    """(3,) low corner for a box with these sides; None where there is none of that kind."""
    if not cluster:
        return np.zeros(3)
    other = cluster[int(rng.integers(len(cluster)))]
    if not other.stands:
        return None
    if rng.random() < STACKED:
        if other.shape.rolls:
            return None
        middle = (other.low + other.high)[:2] / 2
        return np.array([*(middle - sides[:2] / 2), other.high[2]])
    axis, gap = int(rng.integers(2)), rng.uniform(*GAP)
    low = np.zeros(3)
    low[axis] = rng.choice([other.high[axis] + gap, other.low[axis] - gap - sides[axis]])
    along, side = 1 - axis, sides[1 - axis]
    flush = (other.low[along], other.high[along] - side)
    middle = (other.low[along] + other.high[along] - side) / 2
    anywhere = rng.uniform(other.low[along] - 0.6 * side, other.high[along] - 0.4 * side)
    low[along] = rng.choice([*flush, middle, anywhere], p=[0.35, 0.35, 0.15, 0.15])
    return low


def _fits(placed: _Placed, cluster: Sequence[_Placed]) -> bool:
    """Whether nothing is there, and the cluster stays small."""
    lows = np.array([item.low for item in (*cluster, placed)])
    highs = np.array([item.high for item in (*cluster, placed)])
    if (highs.max(axis=0) - lows.min(axis=0))[:2].max() > ACROSS:
        return False
    apart = (placed.low >= highs[:-1] - _TOUCHING) | (placed.high <= lows[:-1] + _TOUCHING)
    return bool(apart.any(axis=1).all())


def _room(
    radius: float,
    taken: Sequence[tuple[Array, float]],
    workspace: Workspace,
    rng: np.random.Generator,
) -> Array | None:
    """(2,) a middle for a disc of this radius, inside of the workspace and clear of the others."""
    room = workspace.side / 2 - SPAWN_MARGIN - radius
    for _ in range(TRIES):
        middle = workspace.middle + rng.uniform(-room, room, 2)
        if all(np.hypot(*(middle - other)) > radius + r + APART for other, r in taken):
            return np.asarray(middle)
    return None
