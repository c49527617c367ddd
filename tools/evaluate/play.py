"""Seeded episodes in parallel processes, each with its log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from policies.shipped import open_policy
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.session import log_episode
from tools.evaluate.tables import Table
from tools.pool import process_pool


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One episode to play. goal: fetch one object, instead of clearing the table."""

    policy: str | None
    cell: CellConfig
    table: Table
    goal: bool
    seed: int
    log: Path


def play_all(trials: Sequence[Trial], *, workers: int) -> Iterator[Trial]:
    """Yields each trial when its log is complete, in order. Trials with a log are not repeated.

    Ctrl-C lets the episodes that are under way come to their end: a log that the operator ended
    would count as the policy's failure.
    """
    with process_pool(workers) as pool:
        yield from pool.map(_play, trials)


def _play(trial: Trial) -> Trial:
    if trial.log.exists():
        return trial
    import torch

    torch.set_num_threads(1)  # one core a process
    trial.log.with_name(trial.log.name + ".part").unlink(missing_ok=True)  # of a killed process
    log_episode(
        trial.cell,
        open_policy(trial.policy, goal=trial.goal),
        trial.log,
        seed=trial.seed,
        scene=trial.table.scene(trial.cell, trial.seed, goal=trial.goal),
        goal=trial.goal,
    )
    return trial
