"""Seeded episodes in parallel processes, each with its log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from policies.shipped import open_policy
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.session import log_episode
from tdpg_deploy.sim.scene_file import load_scene
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.workspace import workspace_of


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One episode to play. table: a scene file, or how many random objects."""

    policy: str | None
    cell: CellConfig
    table: Path | int
    seed: int
    log: Path

    @property
    def scene(self) -> str:
        """The table's name."""
        return f"random {self.table}" if isinstance(self.table, int) else self.table.stem


def play_all(trials: Sequence[Trial], *, workers: int) -> Iterator[Trial]:
    """Yields each trial when its log is complete, in order. Trials with a log are not repeated."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(_play, trials)


def _play(trial: Trial) -> Trial:
    if trial.log.exists():
        return trial
    import torch

    torch.set_num_threads(1)  # one core a process
    workspace = workspace_of(trial.cell)
    if isinstance(trial.table, int):
        scene = random_scene(trial.table, workspace, np.random.default_rng(trial.seed))
    else:
        scene = load_scene(trial.table, workspace)
    log_episode(trial.cell, open_policy(trial.policy), trial.log, seed=trial.seed, scene=scene)
    return trial
