"""Pushes on random tables, each tried from the same look, and what every object came to.

A pure function of its task, in a process of its own: same task, same record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
import torch

from policies.border import border_occupancy
from policies.decide import best_apart, to_primitive
from policies.heightmap import SIZE, Heightmap
from policies.learned import fastest_dtype
from policies.networks.twin import PushNet
from policies.policy import ROTATIONS, Choice
from policies.pushable import all_pushes, pushable
from policies.rotation import back_to_map, pictures
from policies.standing import Map, rising
from policies.state import encode
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.choosing import GOAL_PIXELS
from tdpg_deploy.errors import DeviceError, PlanRefused, SceneError
from tdpg_deploy.execution import execute, make_ready
from tdpg_deploy.motion import plan_primitive
from tdpg_deploy.safety import check
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.scenes import MAX_OBJECTS, Scene
from tdpg_deploy.workspace import workspace_of
from tools.train.config import Randomization
from tools.train.laid import as_left, random_table, world_of
from tools.train.pushes.free import Flags, Owners, free, look, on_table, taken_by_grasps
from tools.train.randomize import randomized
from tools.train.record import Record
from tools.train.replay import pack_height

Place: TypeAlias = tuple[int, int, int]  # rotation, row, column

STUCK = (
    0.85  # share of the tables with something that no grasp can take, on which just that is left
)
FOR_A_GOAL = 0.4  # share of the pushes there that are made for one object's sake
PUSHES_A_LOOK = 3
HEMMED_IN = 0.65  # part of a goal's border that is occupied, from which on it is hemmed in ...
PUSHES_A_KNOT = 6  # from a look at one that is, for most of them free nothing ...
PUSHES_A_HARD = 10  # ... and at one that is not freed by the first that are tried
KINDS = (0.3, 0.4, 0.3)  # shares of pushes by how promising their kind is (policies/pushable.py)
GOAL_KINDS = (0.25, 0.25, 0.2, 0.15, 0.15)


@dataclass(frozen=True, kw_only=True)
class PushTask:
    """Play until so many pushes were made; write the record to `file`. chooser: weights of a
    PushNet, of whose best pushes each look's are made; None: any that are allowed. explored: share
    that are any nevertheless. compact: share of the clusters that grow compact. knots: only looks
    at something that is hemmed in are kept, and pushes are for what is so most. hard: and a look
    is left when that is freed, so most pushes begin where what is chosen frees nothing. shapes: of
    the blocks."""

    cell: CellConfig
    randomization: Randomization
    seed: tuple[int, ...]
    pushes: int
    file: Path
    chooser: Path | None = None
    explored: float = 0.0
    compact: float = 0.0
    knots: bool = False
    hard: bool = False
    shapes: tuple[str, ...] = tuple(SHAPES)


@dataclass(frozen=True, kw_only=True, eq=False)
class PushRecord(Record):
    """heights, colors, owners: (n, 224, 224, ...) looks. free: (n, 30) which objects a grasp could
    take; stuck: (n,) no grasp could take any, if all was seen. objects: (n,) how many.

    pushes: (m, 4) look, rotation, row, column. free_after, on_table_after, taken_after: (m, 30)
    which objects a grasp could take then, which lie in the workspace, and which come away without
    another push; the last of stuck looks only.
    """

    heights: npt.NDArray[np.uint16]
    colors: npt.NDArray[np.uint8]
    owners: npt.NDArray[np.int8]
    objects: npt.NDArray[np.int8]
    free: npt.NDArray[np.bool_]
    stuck: npt.NDArray[np.bool_]
    pushes: npt.NDArray[np.int16]
    free_after: npt.NDArray[np.bool_]
    on_table_after: npt.NDArray[np.bool_]
    taken_after: npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Look:
    heightmap: Heightmap
    owners: Owners
    free: Flags
    stuck: bool
    knot: bool  # pushes are for the goal that is most hemmed in

    def aimed(self, rng: np.random.Generator) -> Heightmap | None:
        """At all that stands there, or at an object that no grasp could take: its goal."""
        if self.knot:
            return None if self.hemmed_in is None else self._at(self.hemmed_in)
        if self.stuck and rng.random() >= FOR_A_GOAL:
            return self.heightmap
        goals = self._goals()
        return self._at(rng.choice(goals)) if goals.size else None

    @cached_property
    def hemmed_in(self) -> int | None:
        """That goal; None where nothing is HEMMED_IN."""
        occupied = {goal: border_occupancy(self._at(goal)) for goal in self._goals().tolist()}
        most = max(occupied, key=occupied.__getitem__, default=None)
        return None if most is None or occupied[most] < HEMMED_IN else most

    def _at(self, goal: int) -> Heightmap:
        return replace(self.heightmap, goal=self.owners == goal)

    def _goals(self) -> npt.NDArray[np.intp]:
        """Objects that are seen, and that no grasp could take."""
        objects = len(self.free)
        shown = np.bincount(self.owners[self.owners >= 0], minlength=objects) >= GOAL_PIXELS
        return np.flatnonzero(shown & ~self.free)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pushed:
    place: Place
    free: Flags
    on_table: Flags
    taken: Flags


Choose: TypeAlias = Callable[[_Look, np.random.Generator], Place | None]


def play_pushes(task: PushTask) -> Path:
    """Does nothing where the record is there already."""
    import cv2

    if task.file.exists():
        return task.file
    cv2.setNumThreads(1)  # one core a worker
    torch.set_num_threads(1)
    choose = any_of_a_kind if task.chooser is None else Chooser(task.chooser)
    if task.explored:
        choose = partial(any_of_a_kind_or, choose, task.explored)
    rng = np.random.default_rng(task.seed)
    looks: list[_Look] = []
    pushes: list[tuple[int, _Pushed]] = []
    while len(pushes) < task.pushes:
        config = randomized(task.cell, task.randomization, rng)
        try:
            seen, pushed = _try_table(config, choose, task, rng)
        except (SceneError, DeviceError):
            continue  # too much for the table, or an arm that is caught: another table
        if pushed:
            pushes += [(len(looks), push) for push in pushed]
            looks.append(seen)
    _record(looks, pushes).save(task.file)
    return task.file


def _try_table(
    config: CellConfig, choose: Choose, task: PushTask, rng: np.random.Generator
) -> tuple[_Look, list[_Pushed]]:
    """One look, and pushes that begin from it: each on a table of its own that is laid the same."""
    scene, stuck = _settled(config, task, rng)
    seen: _Look | None = None
    pushed = []
    most = PUSHES_A_HARD if task.hard else PUSHES_A_KNOT if task.knots else PUSHES_A_LOOK
    for _ in range(most):
        with open_cell(config, scene=scene, seed=int(rng.integers(2**31))) as cell:
            if seen is None:
                heightmap, owners = look(cell)
                now_free = free(heightmap, owners, len(scene.objects))
                seen = _Look(
                    heightmap=heightmap,
                    owners=owners,
                    free=now_free,
                    stuck=stuck,
                    knot=task.knots,
                )
            place = choose(seen, rng)
            if place is None:
                break
            if _push(cell, seen.heightmap, place):
                heightmap, owners = look(cell)
                world = world_of(cell)
                left = on_table(world)
                taken = taken_by_grasps(world) if stuck else np.zeros_like(left)
                now_free = free(heightmap, owners, len(left))
                pushed.append(_Pushed(place=place, free=now_free, on_table=left, taken=taken))
                if task.hard and seen.hemmed_in is not None and now_free[seen.hemmed_in]:
                    break
    assert seen is not None
    return seen, pushed


def _settled(config: CellConfig, task: PushTask, rng: np.random.Generator) -> tuple[Scene, bool]:
    """A table at rest, and whether all that lies on it is what no grasp could take."""
    blocks = {name: SHAPES[name] for name in task.shapes}
    scene = random_table(workspace_of(config), task.compact, rng, blocks)
    with open_cell(config, scene=scene, seed=int(rng.integers(2**31))) as cell:
        world = world_of(cell)
        at_rest = world.objects()
        held_fast = on_table(world) & ~taken_by_grasps(world)
        stuck = bool(held_fast.sum() >= 2 and rng.random() < STUCK)
        kept = held_fast if stuck else on_table(world)
    return as_left(scene, at_rest, kept.tolist()), stuck


def any_of_a_kind(seen: _Look, rng: np.random.Generator) -> Place | None:
    """One that is allowed: of all, or for the sake of an object that no grasp could take."""
    aimed = seen.aimed(rng)
    if aimed is None:
        return None
    shares = KINDS if aimed.goal is None else GOAL_KINDS
    return _of_kinds(list(pushable(aimed)), shares, rng)


def any_of_a_kind_or(
    choose: Choose, explored: float, seen: _Look, rng: np.random.Generator
) -> Place | None:
    """That share of them any of a kind."""
    return any_of_a_kind(seen, rng) if rng.random() < explored else choose(seen, rng)


class Chooser:
    """A PushNet's best pushes of one look for one aim, one after the other, none near another."""

    def __init__(self, weights: Path) -> None:
        network = PushNet()
        network.load_state_dict(torch.load(weights, weights_only=True))
        self._network = network.eval().requires_grad_(False).to(fastest_dtype())
        self._seen: _Look | None = None
        self._pushes: Iterator[Choice] = iter(())

    def __call__(self, seen: _Look, rng: np.random.Generator) -> Place | None:
        if self._seen is not seen:
            self._seen, aimed = seen, seen.aimed(rng)
            if aimed is None:
                self._pushes = iter(())
            else:
                self._pushes = best_apart(self._values(aimed), "push", rng)
        push = next(self._pushes, None)
        return None if push is None else (push.rotation, push.row, push.col)

    def _values(self, aimed: Heightmap) -> Map:
        """(16, 224, 224), -inf where no push is allowed."""
        goal = rising(aimed) if aimed.goal is None else aimed.goal
        state = encode(replace(aimed, goal=goal), goal=True).to(fastest_dtype())
        values = back_to_map(self._network.values(pictures(state)).float())[:, 0].numpy()
        return np.where(all_pushes(aimed), values, np.float32(-np.inf))


def _of_kinds(
    kinds: Sequence[npt.NDArray[np.bool_]], shares: Sequence[float], rng: np.random.Generator
) -> Place | None:
    """Any push of a kind drawn by its share; of the least promising where it has none."""
    drawn = int(rng.choice(len(kinds), p=shares))
    for kind in (drawn, *reversed(range(len(kinds)))):
        places = np.flatnonzero(kinds[kind])
        if places.size:
            place = np.unravel_index(rng.choice(places), (ROTATIONS, SIZE, SIZE))
            rotation, row, col = (int(index) for index in place)
            return rotation, row, col
    return None


def _push(cell: Cell, seen: Heightmap, place: Place) -> bool:
    """Whether it was made: its plan passed, and nothing caught the arm."""
    rotation, row, col = place
    choice = Choice(kind="push", rotation=rotation, row=row, col=col, q=0.0)
    try:
        plan = plan_primitive(to_primitive(choice, seen), seen, cell.config)
        check(plan, cell.config)
        make_ready(cell)
        execute(plan, cell)
    except (PlanRefused, DeviceError):
        return False
    return True


def _record(looks: Sequence[_Look], pushes: Sequence[tuple[int, _Pushed]]) -> PushRecord:
    return PushRecord(
        heights=np.array([pack_height(seen.heightmap.height) for seen in looks]),
        colors=np.array([seen.heightmap.color for seen in looks]),
        owners=np.array([seen.owners for seen in looks]),
        objects=np.array([len(seen.free) for seen in looks], np.int8),
        free=_padded(seen.free for seen in looks),
        stuck=np.array([seen.stuck for seen in looks]),
        pushes=np.array([(index, *push.place) for index, push in pushes], np.int16),
        free_after=_padded(push.free for _, push in pushes),
        on_table_after=_padded(push.on_table for _, push in pushes),
        taken_after=_padded(push.taken for _, push in pushes),
    )


def _padded(flags: Iterator[Flags]) -> npt.NDArray[np.bool_]:
    return np.array([np.pad(each, (0, MAX_OBJECTS - len(each))) for each in flags])
