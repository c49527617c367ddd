"""Grasps on random tables of which a policy is not sure, each tried from the same look, and whether
they held.

A pure function of its task, in a process of its own: same task, same record.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from policies.checkpoint import load_checkpoint
from policies.decide import best_grasps, to_primitive
from policies.fingers import under_open_gripper
from policies.heightmap import Heightmap
from policies.learned import LearnedPolicy
from policies.masks import AllowedMaps, graspable
from policies.policy import HALF_TURN, Choice, Decision
from policies.primitives import Primitive, Push
from policies.standing import Mask
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode import run_episode, witnessed
from tdpg_deploy.episode_record import NullRecorder
from tdpg_deploy.errors import DeviceError, PlanRefused, SceneError
from tdpg_deploy.execution import execute, make_ready
from tdpg_deploy.motion import plan_primitive
from tdpg_deploy.outcome import Verdict
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.safety import check
from tdpg_deploy.sim.scenes import Scene
from tdpg_deploy.sim.world import Where
from tdpg_deploy.workspace import workspace_of
from tools.train.config import Randomization
from tools.train.laid import as_left, random_table, world_of
from tools.train.randomize import randomized
from tools.train.record import Record
from tools.train.replay import pack_height

SURE = 0.97  # P_success of what a policy is about to do, from which on it is in no doubt ...
KEPT = 0.06  # ... and of such looks so many are kept
A_TABLE = 10  # looks, at most: an episode may be in the same doubt for long
DRAWN = 30  # grasps at random, of which those are tried too ...
PROMISING = 4  # ... that Critic II gives most, ...
ANY = 2  # ... and so many others


@dataclass(frozen=True, kw_only=True)
class GraspTask:
    """Play until so many grasps were tried; write the record to `file`. weights: the policy that
    is in doubt; it clears the tables. compact: share of the clusters that grow compact."""

    weights: Path
    cell: CellConfig
    randomization: Randomization
    seed: tuple[int, ...]
    grasps: int
    file: Path
    compact: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspRecord(Record):
    """heights, colors: (n, 224, 224, ...) looks. grasps: (m, 4) look, rotation, row, column.
    held: (m,) by both witnesses."""

    heights: npt.NDArray[np.uint16]
    colors: npt.NDArray[np.uint8]
    grasps: npt.NDArray[np.int16]
    held: npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Doubt:
    """A look, the grasps to be tried from it, and what lies on the table."""

    heightmap: Heightmap
    grasps: Sequence[Choice]
    scene: Scene


class Doubting:
    """A decider that goes its policy's way, and keeps the looks at which that is in doubt."""

    def __init__(self, policy: LearnedPolicy, cell: Cell, scene: Scene) -> None:
        self.doubts: list[Doubt] = []
        self._policy = policy
        self._world = world_of(cell)
        self._scene = scene
        self._seen: Heightmap | None = None

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        decision = self._policy.decide(heightmap, rng, avoid=avoid)
        if heightmap is not self._seen and self._in_doubt(decision, heightmap, rng):
            states = self._world.objects()
            kept = [state.where is Where.WORKSPACE for state in states]
            self.doubts.append(
                Doubt(
                    heightmap=heightmap,
                    grasps=self._worth_trying(decision, heightmap, rng),
                    scene=as_left(self._scene, states, kept),
                )
            )
        self._seen = heightmap  # decided on again when a plan is refused
        return decision

    def _in_doubt(self, decision: Decision, heightmap: Heightmap, rng: np.random.Generator) -> bool:
        if isinstance(decision.primitive, Push):
            return True
        chosen = Choice(
            kind="grasp",
            rotation=decision.rotation,
            row=decision.row,
            col=decision.col,
            q=decision.q,
        )
        return self._policy.p_success(heightmap, [chosen])[0] < SURE or rng.random() < KEPT

    def _worth_trying(
        self, decision: Decision, heightmap: Heightmap, rng: np.random.Generator
    ) -> list[Choice]:
        """What Critic II was asked about, and of some drawn at random those that it gives most and
        a few others. Where nothing but a push was left, these may squeeze out what they close on.
        """
        maps = decision.maps
        assert isinstance(maps, AllowedMaps)
        asked = best_grasps(maps, rng, sure=maps.sure, count=self._policy.method.considered)
        pushes = isinstance(decision.primitive, Push)
        possible = (
            _closes_on_something(heightmap) if pushes else np.isfinite(maps.grasp[:HALF_TURN])
        )
        places = np.argwhere(possible)
        drawn = [
            Choice(
                kind="grasp",
                rotation=rotation,
                row=row,
                col=col,
                q=float(maps.grasp[rotation, row, col]),
            )
            for rotation, row, col in rng.permutation(places)[:DRAWN].tolist()
        ]
        if not drawn:
            return list(asked)
        order = np.argsort(-self._policy.p_success(heightmap, drawn))
        others = rng.permutation(order[PROMISING:])[:ANY]
        return [*asked, *(drawn[i] for i in (*order[:PROMISING], *others))]


def _closes_on_something(heightmap: Heightmap) -> Mask:
    """(8, 224, 224), whether it would hold that or not."""
    return graspable(heightmap, under_open_gripper(heightmap))[:HALF_TURN]


def play_grasps(task: GraspTask) -> Path:
    """Does nothing where the record is there already."""
    import cv2

    if task.file.exists():
        return task.file
    cv2.setNumThreads(1)  # one core a worker
    torch.set_num_threads(1)
    policy = load_checkpoint(task.weights).policy()
    rng = np.random.default_rng(task.seed)
    doubts: list[Doubt] = []
    made: list[tuple[int, Choice, bool]] = []
    while len(made) < task.grasps:
        config = randomized(task.cell, task.randomization, rng)
        try:
            found = _doubts(config, policy, task.compact, rng)
        except (SceneError, DeviceError):
            continue  # too much for the table, or an arm that is caught: another table
        for doubt in found:
            made += [(len(doubts), *each) for each in tried(config, doubt, rng)]
            doubts.append(doubt)
    _record(doubts, made).save(task.file)
    return task.file


def _doubts(
    config: CellConfig, policy: LearnedPolicy, compact: float, rng: np.random.Generator
) -> list[Doubt]:
    """Of an episode that clears a random table, any A_TABLE of them."""
    scene = random_table(workspace_of(config), compact, rng)
    with open_cell(config, scene=scene, seed=int(rng.integers(2**31))) as cell:
        doubting = Doubting(policy, cell, scene)
        run_episode(cell, doubting, rng=rng, log=NullRecorder())
    found = doubting.doubts
    return [found[i] for i in sorted(rng.permutation(len(found))[:A_TABLE])]


def tried(
    config: CellConfig, doubt: Doubt, rng: np.random.Generator
) -> Iterator[tuple[Choice, bool]]:
    """Each grasp that could be made, on a table of its own that is laid the same; whether it
    held."""
    seen = doubt.heightmap
    for grasp in doubt.grasps:
        try:
            plan = plan_primitive(to_primitive(grasp, seen), seen, config)
            check(plan, config)
            with open_cell(config, scene=doubt.scene, seed=int(rng.integers(2**31))) as cell:
                make_ready(cell)
                outcome = execute(plan, cell)
                frame = cell.camera.capture()
        except (PlanRefused, DeviceError):
            continue
        after = build_heightmap(frame, config.X_base_camera, workspace_of(config))
        outcome = witnessed(outcome, plan.primitive, seen, after)
        yield grasp, outcome.success is Verdict.YES


def _record(doubts: Sequence[Doubt], made: Sequence[tuple[int, Choice, bool]]) -> GraspRecord:
    return GraspRecord(
        heights=np.array([pack_height(doubt.heightmap.height) for doubt in doubts]),
        colors=np.array([doubt.heightmap.color for doubt in doubts]),
        grasps=np.array(
            [(look, grasp.rotation, grasp.row, grasp.col) for look, grasp, _ in made], np.int16
        ),
        held=np.array([held for *_, held in made]),
    )
