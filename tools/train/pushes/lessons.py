"""Records of pushes -> what PushNet is asked, and the answers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from policies.heightmap import PIXEL
from policies.networks.twin import AHEAD, PushNet
from policies.policy import ROTATIONS
from policies.primitives import PUSH_LENGTH
from policies.rotation import around
from policies.standing import RISE
from policies.state import stacked
from tdpg_deploy.choosing import GOAL_PIXELS
from tdpg_deploy.sim.scenes import MAX_OBJECTS
from tools.train.cut import METRES, cut
from tools.train.pushes.play import PushRecord
from tools.train.replay import UNSEEN

BESIDE = 0.06  # m to both sides of a push, and beyond its end, within which it concerns a goal
ALL = -1  # in place of a goal: all that stands on the table
OUTSIDE = -2  # owner of what lies outside of the workspace

Array = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Lessons:
    """heights, colors, owners: (m, PATCH, PATCH, ...) around the middles of pushes' ways, turned so
    that they lead upwards; places: (m, 2) of the middles in them, in [-1, 1].

    push: (n,) which of them a lesson is about. goal: (n,) the object that it is to free, or ALL.
    answer: (n,) what of it was freed, 0 to 1. look: (n,) what the push began from.
    """

    heights: npt.NDArray[np.uint16]
    colors: npt.NDArray[np.uint8]
    owners: npt.NDArray[np.int8]
    places: Array
    push: npt.NDArray[np.intp]
    goal: npt.NDArray[np.int8]
    answer: Array
    look: npt.NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.answer)

    def questions(
        self, picks: npt.NDArray[np.intp], rng: np.random.Generator | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Patches (n, 7, PATCH, PATCH) and places (n, 2), as PushNet is shown them.

        rng: half of them mirrored, and the colours of each thing changed with each other: a gripper
        and a table have no left and right, and colours mean nothing to a block.
        """
        pushes, goals = self.push[picks], self.goal[picks, None, None]
        height, color, owner = self.heights[pushes], self.colors[pushes], self.owners[pushes]
        places = self.places[pushes].copy()
        if rng is not None:
            mirrored = rng.random(len(picks)) < 0.5
            for picture in (height, color, owner):
                picture[mirrored] = picture[mirrored][:, :, ::-1]
            places[mirrored, 0] *= -1
            color = np.stack([_recolored(*each, rng) for each in zip(color, owner, strict=True)])
        metres = METRES[height]
        with np.errstate(invalid="ignore"):
            goal = np.where(goals == ALL, metres > RISE, owner == goals)
        patches = stacked(owner != OUTSIDE, metres, color, goal)
        return torch.from_numpy(patches), torch.from_numpy(places)


def _recolored(
    color: npt.NDArray[np.uint8], owner: npt.NDArray[np.int8], rng: np.random.Generator
) -> npt.NDArray[np.uint8]:
    """(h, w, 3), (h, w): of every object, and of what is none, red, green and blue changed with
    each other."""
    things = np.tile(np.arange(3), (MAX_OBJECTS - OUTSIDE, 1))  # those below zero are the last
    return np.take_along_axis(color, rng.permuted(things, axis=1)[owner], axis=-1)


def lessons_of(records: Sequence[PushRecord]) -> Lessons:
    """Of every push, for each object near its way that no grasp could take before, whether one can
    now. And of tables from which no grasp could take anything, the share of the objects that come
    away without another push."""
    cuts = [_cut(record) for record in records]
    rows: list[tuple[int, int, float, int]] = []
    pushes = looks = 0
    for record in records:
        for number, look in enumerate(record.pushes[:, 0].tolist()):
            asked = [*_of_all(record, number), *_of_goals(record, number)]
            rows += [(pushes + number, thing, freed, looks + look) for thing, freed in asked]
        pushes += len(record.pushes)
        looks += len(record.heights)
    push, goal, freed, look = np.array(rows, np.float64).reshape(-1, 4).T
    heights, colors, owners, places = (np.concatenate(parts) for parts in zip(*cuts, strict=True))
    return Lessons(
        heights=heights,
        colors=colors,
        owners=owners,
        places=places,
        push=push.astype(np.intp),
        goal=goal.astype(np.int8),
        answer=freed.astype(np.float32),
        look=look.astype(np.intp),
    )


def _cut(
    record: PushRecord,
) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint8], npt.NDArray[np.int8], Array]:
    """Of each push: heights, colours and owners around the middle of its way, and its place."""
    look, rotation, row, col = record.pushes.astype(np.intp).T
    yaw = rotation * (2 * np.pi / ROTATIONS)
    index, places = around(
        torch.from_numpy(rotation),
        torch.from_numpy(row - AHEAD * np.cos(yaw)),
        torch.from_numpy(col - AHEAD * np.sin(yaw)),
        size=PushNet.PATCH,
        stride=PushNet.STRIDE,
    )
    at = index.numpy()
    return (
        cut(record.heights, look, at, int(UNSEEN)),
        cut(record.colors, look, at, 0),
        cut(record.owners, look, at, OUTSIDE),
        places.numpy(),
    )


def _of_all(record: PushRecord, push: int) -> Iterator[tuple[int, float]]:
    look = record.pushes[push, 0]
    if record.stuck[look]:
        yield ALL, float(record.taken_after[push].sum() / record.objects[look])


def _of_goals(record: PushRecord, push: int) -> Iterator[tuple[int, float]]:
    look, rotation, row, col = record.pushes[push].tolist()
    owners, yaw = record.owners[look], rotation * 2 * np.pi / ROTATIONS
    rows, cols = np.nonzero(owners >= 0)
    owner, up, left = owners[rows, cols], np.cos(yaw), np.sin(yaw)
    along = (row - rows) * up + (col - cols) * left
    aside = np.abs((row - rows) * left - (col - cols) * up)
    reach = BESIDE / PIXEL
    near = (aside <= reach) & (along >= -reach / 2) & (along <= PUSH_LENGTH / PIXEL + reach)
    objects = record.objects[look]
    shown = np.bincount(owner, minlength=objects) >= GOAL_PIXELS
    concerned = np.bincount(owner[near], minlength=objects) > 0
    freed = record.free_after[push] & record.on_table_after[push]
    for goal in np.flatnonzero(concerned & shown & ~record.free[look, :objects]).tolist():
        yield goal, float(freed[goal])
