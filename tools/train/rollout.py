"""Experience for one worker and one round: the deployed loop itself, on random tables.

A pure function of its task, in a process of its own: same task, same experience.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from policies.checkpoint import load_checkpoint
from policies.decide import best_grasps
from policies.heightmap import SIZE, Heightmap
from policies.policy import Decision
from policies.primitives import Push
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode import run_episode
from tdpg_deploy.episode_record import NullRecorder
from tdpg_deploy.hal import RgbdFrame
from tdpg_deploy.outcome import Outcome, Verdict
from tdpg_deploy.plan import Plan
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.workspace import workspace_of
from tools.train.config import Randomization
from tools.train.explore import Exploring
from tools.train.randomize import randomized
from tools.train.replay import CANDIDATES, TRANSITION, pack_height


@dataclass(frozen=True, kw_only=True)
class RolloutTask:
    """weights: the frozen policy of this round. objects: least and most on a table."""

    weights: Path
    cell: CellConfig
    randomization: Randomization
    seed: tuple[int, ...]
    actions: int
    objects: tuple[int, int]
    epsilon: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Experience:
    """heights (n, 224, 224) packed, colors (n, 224, 224, 3), transitions (m,), whose looks are
    indices into these."""

    heights: npt.NDArray[np.uint16]
    colors: npt.NDArray[np.uint8]
    transitions: npt.NDArray[np.void]


def play(task: RolloutTask) -> Experience:
    """Clear random tables until `task.actions` actions were made."""
    import torch

    torch.set_num_threads(1)  # one core a worker
    rng = np.random.default_rng(task.seed)
    policy = Exploring(load_checkpoint(task.weights).policy(), task.epsilon)
    note = _Notebook(rng)
    while len(note.transitions) < task.actions:
        config = randomized(task.cell, task.randomization, rng)
        config = _with_budget(config, task.actions - len(note.transitions))
        count = int(rng.integers(task.objects[0], task.objects[1] + 1))
        scene = random_scene(count, workspace_of(config), rng)
        with open_cell(config, scene=scene, seed=int(rng.integers(2**31))) as cell:
            run_episode(cell, policy, rng=rng, log=note)
    return note.experience()


def _with_budget(config: CellConfig, actions: int) -> CellConfig:
    """A learner may fail as often as it likes, within what is left of the round."""
    episode = config.episode.model_copy(update={"max_actions": actions, "max_failures": 1000})
    return config.model_copy(update={"episode": episode})


class _Notebook(NullRecorder):
    """An EpisodeRecorder that keeps looks and transitions."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._heights: list[npt.NDArray[np.uint16]] = []
        self._colors: list[npt.NDArray[np.uint8]] = []
        self.transitions: list[npt.NDArray[np.void]] = []
        self._pending: npt.NDArray[np.void] | None = None  # acted, outcome unknown
        self._open: npt.NDArray[np.void] | None = None  # concluded, value of what follows unknown

    def observe(self, frame: RgbdFrame, heightmap: Heightmap) -> None:
        self._heights.append(pack_height(heightmap.height))
        self._colors.append(heightmap.color)

    def intend(self, decision: Decision, plan: Plan, *, stamp: float) -> None:
        if self._open is not None:
            grasps = [(g.rotation, g.row, g.col) for g in best_grasps(decision.maps, self._rng)]
            if grasps:  # repeat the best to fill up: the maximum stays the same
                grasps += [grasps[0]] * (CANDIDATES - len(grasps))
                self._open["next_look"] = self._latest
                self._open["next_grasps"] = grasps
            self._open = None
        action = np.zeros((), TRANSITION)
        action["look"] = self._latest
        action["next_look"] = -1
        action["push"] = isinstance(decision.primitive, Push)
        action["rotation"], action["row"], action["col"] = (
            decision.rotation,
            decision.row,
            decision.col,
        )
        self._pending = action

    def conclude(self, outcome: Outcome, *, stamp: float) -> None:
        action, self._pending = self._pending, None
        assert action is not None
        if outcome.success is Verdict.UNKNOWN:
            return  # nothing to learn from
        action["reward"] = action["grasped"] = outcome.success is Verdict.YES
        self.transitions.append(action)
        self._open = action

    def end(self, *_: object, **__: object) -> None:
        self._open = self._pending = None

    def experience(self) -> Experience:
        return Experience(
            heights=np.array(self._heights, np.uint16).reshape(-1, SIZE, SIZE),
            colors=np.array(self._colors, np.uint8).reshape(-1, SIZE, SIZE, 3),
            transitions=np.array(self.transitions, TRANSITION),
        )

    @property
    def _latest(self) -> int:
        return len(self._heights) - 1
