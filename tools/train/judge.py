"""Validation while training: a greedy episode on a table that nothing is learnt from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from policies.checkpoint import load_checkpoint
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode import run_episode
from tdpg_deploy.episode_record import NullRecorder
from tools.evaluate.metrics import EpisodeRow, Estimate, evaluate
from tools.evaluate.tables import RandomTable
from tools.train.curve import Validation


@dataclass(frozen=True, kw_only=True)
class JudgeTask:
    weights: Path
    cell: CellConfig
    objects: int
    seed: int


def judge(task: JudgeTask) -> EpisodeRow:
    """One episode. With a goal, one of the objects in sight is to be fetched."""
    import torch

    torch.set_num_threads(1)  # one core a worker
    policy = load_checkpoint(task.weights).policy()
    rng = np.random.default_rng(task.seed)
    table = RandomTable(objects=task.objects)
    scene = table.scene(task.cell, task.seed, goal=policy.goal)
    with open_cell(task.cell, scene=scene, seed=task.seed) as cell:
        result = run_episode(cell, policy, rng=rng, log=NullRecorder(), goal=policy.goal)
    return EpisodeRow(
        scene=table.name,
        seed=task.seed,
        reason=result.reason,
        objects=1 if policy.goal else task.objects,
        actions=result.actions,
        grasps=result.grasps,
        grasp_successes=result.grasp_successes,
        goal=policy.goal,
    )


def summed_up(rows: Sequence[EpisodeRow]) -> Validation | None:
    """None of no episodes."""
    if not rows:
        return None
    metrics = evaluate(rows)
    figures = metrics.of_all
    return Validation(
        completion=metrics.completion.value,
        grasp_success=_or_none(figures.grasp_success),
        efficiency=_or_none(figures.action_efficiency),
        motions=figures.motions.value,
    )


def _or_none(estimate: Estimate) -> float | None:
    return None if math.isnan(estimate.value) else estimate.value
