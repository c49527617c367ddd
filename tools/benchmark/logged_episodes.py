"""Logs to measure with: episodes of the shipped policy in the simulated cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from policies.shipped import open_policy
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.session import log_episode
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.workspace import workspace_of

OBJECTS = 30


def simulate(folder: Path, *, episodes: int, actions: int) -> list[Path]:
    """Logs of that many episodes, each of `actions` actions (fewer if the table is cleared)."""
    cell = load_cell(DEFAULT_CELL)
    limits = {"max_actions": actions, "max_failures": actions}
    cell = cell.model_copy(update={"episode": cell.episode.model_copy(update=limits)})
    policy = open_policy()
    logs = []
    for seed in range(episodes):
        scene = random_scene(OBJECTS, workspace_of(cell), np.random.default_rng(seed))
        logs.append(folder / f"seed{seed}.mcap")
        log_episode(cell, policy, logs[-1], seed=seed, scene=scene)
    return logs


def replicate(logs: list[Path], folder: Path, *, episodes: int) -> None:
    """`episodes` names for `logs`, in turn: each file is one episode to whoever reads a folder."""
    folder.mkdir()
    for number in range(episodes):
        source = logs[number % len(logs)]
        (folder / f"episode{number:04d}.mcap").hardlink_to(source)
