"""Pushes on random tables, each tried from the same look, and what every object came to.

A pure function of its task, in a process of its own: same task, same record.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from policies.decide import Choice, to_primitive
from policies.heightmap import SIZE, Heightmap, Workspace
from policies.policy import ROTATIONS
from policies.pushable import pushable
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.choosing import GOAL_PIXELS
from tdpg_deploy.errors import DeviceError, PlanRefused, SceneError
from tdpg_deploy.execution import execute, make_ready
from tdpg_deploy.motion import plan_primitive
from tdpg_deploy.safety import check
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.clusters import clustered_scene
from tdpg_deploy.sim.random_shapes import odd_shapes
from tdpg_deploy.sim.scenes import MAX_OBJECTS, MAX_PACKED, Scene, packed_scene, random_scene
from tdpg_deploy.sim.world import World
from tdpg_deploy.workspace import workspace_of
from tools.goals import detector_of
from tools.train.config import Randomization
from tools.train.pushes.free import Flags, Owners, free, look, on_table, taken_by_grasps
from tools.train.randomize import randomized
from tools.train.replay import pack_height

ODD, HEAPS, PACKS = 0.12, 0.12, 0.23  # shares of tables of stones, in heaps, in rows; else clusters
HEAP = (3, 25)  # objects
STUCK = (
    0.85  # share of the tables with something that no grasp can take, on which just that is left
)
FOR_A_GOAL = 0.4  # share of the pushes there that are made for one object's sake
PUSHES_A_LOOK = 3
KINDS = (0.3, 0.4, 0.3)  # shares of pushes by how promising their kind is (policies/pushable.py)
GOAL_KINDS = (0.25, 0.25, 0.2, 0.15, 0.15)


@dataclass(frozen=True, kw_only=True)
class PushTask:
    """Play until so many pushes were made; write the record to `file`."""

    cell: CellConfig
    randomization: Randomization
    seed: tuple[int, ...]
    pushes: int
    file: Path


@dataclass(frozen=True, kw_only=True, eq=False)
class PushRecord:
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

    def save(self, path: Path) -> None:
        """Whole or not at all."""
        part = path.with_name(path.name + ".part")
        with part.open("wb") as file:
            np.savez(file, **{field.name: getattr(self, field.name) for field in fields(self)})
        os.replace(part, path)

    @classmethod
    def load(cls, path: Path) -> PushRecord:
        with np.load(path, allow_pickle=False) as arrays:
            return cls(**{field.name: arrays[field.name] for field in fields(cls)})


@dataclass(frozen=True, kw_only=True, eq=False)
class _Look:
    heightmap: Heightmap
    owners: Owners
    free: Flags
    stuck: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pushed:
    place: tuple[int, int, int]
    free: Flags
    on_table: Flags
    taken: Flags


def play_pushes(task: PushTask) -> Path:
    """Does nothing where the record is there already."""
    import cv2

    if task.file.exists():
        return task.file
    cv2.setNumThreads(1)  # one core a worker
    rng = np.random.default_rng(task.seed)
    looks: list[_Look] = []
    pushes: list[tuple[int, _Pushed]] = []
    while len(pushes) < task.pushes:
        config = randomized(task.cell, task.randomization, rng)
        try:
            seen, pushed = _try_table(config, rng)
        except (SceneError, DeviceError):
            continue  # too much for the table, or an arm that is caught: another table
        if pushed:
            pushes += [(len(looks), push) for push in pushed]
            looks.append(seen)
    _record(looks, pushes).save(task.file)
    return task.file


def random_table(workspace: Workspace, rng: np.random.Generator) -> Scene:
    """Mostly clusters, where pushes matter. Raises SceneError."""
    shapes = odd_shapes(rng) if rng.random() < ODD else SHAPES
    kind = rng.random()
    if kind < HEAPS:
        return random_scene(int(rng.integers(HEAP[0], HEAP[1] + 1)), workspace, rng, shapes)
    if kind < HEAPS + PACKS:
        return packed_scene(int(rng.integers(2, MAX_PACKED + 1)), workspace, rng, shapes)
    return clustered_scene(workspace, rng, shapes)


def _try_table(config: CellConfig, rng: np.random.Generator) -> tuple[_Look, list[_Pushed]]:
    """One look, and pushes that begin from it: each on a table of its own that is laid the same."""
    scene, stuck = _settled(config, rng)
    seen: _Look | None = None
    pushed = []
    for _ in range(PUSHES_A_LOOK):
        with open_cell(config, scene=scene, seed=int(rng.integers(2**31))) as cell:
            if seen is None:
                heightmap, owners = look(cell)
                now_free = free(heightmap, owners, len(scene.objects))
                seen = _Look(heightmap=heightmap, owners=owners, free=now_free, stuck=stuck)
            place = _any_push(seen, rng)
            if place is None:
                break
            if _push(cell, seen.heightmap, place):
                heightmap, owners = look(cell)
                world = world_of(cell)
                left = on_table(world)
                taken = taken_by_grasps(world) if stuck else np.zeros_like(left)
                now_free = free(heightmap, owners, len(left))
                pushed.append(_Pushed(place=place, free=now_free, on_table=left, taken=taken))
    assert seen is not None
    return seen, pushed


def _settled(config: CellConfig, rng: np.random.Generator) -> tuple[Scene, bool]:
    """A table at rest, and whether all that lies on it is what no grasp could take."""
    scene = random_table(workspace_of(config), rng)
    with open_cell(config, scene=scene, seed=int(rng.integers(2**31))) as cell:
        world = world_of(cell)
        at_rest = world.objects()
        held_fast = on_table(world) & ~taken_by_grasps(world)
        stuck = bool(held_fast.sum() >= 2 and rng.random() < STUCK)
        kept = held_fast if stuck else on_table(world)
    return Scene(
        objects=tuple(
            replace(item, X_base_object=state.X_base_object)
            for item, state, keep in zip(scene.objects, at_rest, kept, strict=True)
            if keep
        )
    ), stuck


def _any_push(seen: _Look, rng: np.random.Generator) -> tuple[int, int, int] | None:
    """One that is allowed: of all, or for the sake of an object that no grasp could take."""
    if seen.stuck and rng.random() >= FOR_A_GOAL:
        return _of_kinds(list(pushable(seen.heightmap)), KINDS, rng)
    shown = np.bincount(seen.owners[seen.owners >= 0], minlength=len(seen.free)) >= GOAL_PIXELS
    goals = np.flatnonzero(shown & ~seen.free)
    if not goals.size:
        return None
    aimed = replace(seen.heightmap, goal=seen.owners == rng.choice(goals))
    return _of_kinds(list(pushable(aimed)), GOAL_KINDS, rng)


def _of_kinds(
    kinds: Sequence[npt.NDArray[np.bool_]], shares: Sequence[float], rng: np.random.Generator
) -> tuple[int, int, int] | None:
    """Any push of a kind drawn by its share; of the least promising where it has none."""
    drawn = int(rng.choice(len(kinds), p=shares))
    for kind in (drawn, *reversed(range(len(kinds)))):
        places = np.flatnonzero(kinds[kind])
        if places.size:
            place = np.unravel_index(rng.choice(places), (ROTATIONS, SIZE, SIZE))
            rotation, row, col = (int(index) for index in place)
            return rotation, row, col
    return None


def _push(cell: Cell, seen: Heightmap, place: tuple[int, int, int]) -> bool:
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


def world_of(cell: Cell) -> World:
    """The physics of a simulated cell."""
    return detector_of(cell).world


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
