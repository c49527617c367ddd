"""Experience for one worker and one round: the deployed loop itself, on random tables.

A pure function of its task, in a process of its own: same task, same experience.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from policies.checkpoint import load_checkpoint
from policies.errors import NoActionError
from policies.heightmap import Workspace
from policies.policy import Decider, QMaps
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode import run_episode
from tdpg_deploy.outcome import EndReason
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.random_shapes import odd_shapes
from tdpg_deploy.sim.scenes import MAX_PACKED, Scene, packed_scene, random_scene
from tdpg_deploy.workspace import workspace_of
from tools.goals import detector_of, in_sight
from tools.train.config import PushReward, Randomization, Stage
from tools.train.explore import Exploring
from tools.train.notebook import Experience, Notebook
from tools.train.randomize import randomized


@dataclass(frozen=True, kw_only=True)
class RolloutTask:
    """weights: the frozen policy of this round."""

    weights: Path
    cell: CellConfig
    randomization: Randomization
    push_reward: PushReward
    stage: Stage
    seed: tuple[int, ...]
    actions: int
    epsilon: float


def play(task: RolloutTask) -> Experience:
    """Clear random tables, or fetch one goal after another, until `task.actions` were made."""
    import torch

    torch.set_num_threads(1)  # one core a worker
    rng = np.random.default_rng(task.seed)
    policy = load_checkpoint(task.weights).policy()
    note = Notebook(task.push_reward, rng)
    player = Exploring(policy, task.stage.kind, task.epsilon, prepared=lambda: note.prepared)
    while note.actions < task.actions:
        config = randomized(task.cell, task.randomization, rng)
        scene = _scene(task.stage, workspace_of(config), rng)
        with open_cell(config, scene=scene, seed=int(rng.integers(2**31))) as cell:
            for _ in goals(cell, rng) if policy.goal else [None]:
                left = task.actions - note.actions
                cell.config = _with_budget(config, min(left, task.stage.table_actions or left))
                result = run_episode(cell, player, rng=rng, log=note, goal=policy.goal)
                if result.reason is EndReason.ACTION_LIMIT:
                    note.cut_short(_maps(policy, note, rng))
                    break
                if result.reason is EndReason.DEVICE_ERROR:
                    break  # an arm that is caught is freed by hand; here, by another cell
    return note.experience()


def _scene(stage: Stage, workspace: Workspace, rng: np.random.Generator) -> Scene:
    shapes = SHAPES
    if rng.random() < stage.odd:
        shapes = odd_shapes(rng)
    if rng.random() < stage.packed:
        return packed_scene(int(rng.integers(2, MAX_PACKED + 1)), workspace, rng, shapes)
    count = int(rng.integers(stage.min_objects, stage.max_objects + 1))
    return random_scene(count, workspace, rng, shapes)


def goals(cell: Cell, rng: np.random.Generator) -> Iterator[int]:
    """Show one random object in sight after another as the goal, until there is none or the
    same one was aimed at and is still there: "until the workspace no longer contains any viable
    target objects" (paper, section III-D)."""
    tried: set[int] = set()
    while left := set(in_sight(cell)) - tried:
        goal = int(rng.choice(sorted(left)))
        tried.add(goal)
        detector_of(cell).goals = {goal}
        yield goal


def _maps(policy: Decider, note: Notebook, rng: np.random.Generator) -> QMaps | None:
    try:
        return policy.decide(note.last_seen, rng).maps
    except NoActionError:
        return None


def _with_budget(config: CellConfig, actions: int) -> CellConfig:
    """A learner may fail as often as it likes, within what is left of the round."""
    episode = config.episode.model_copy(update={"max_actions": actions, "max_failures": 1000})
    return config.model_copy(update={"episode": episode})
