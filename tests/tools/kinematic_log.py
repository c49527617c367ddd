"""Logs of episodes on the cell without physics: written in a second."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from kinematic_cell import Box, Table, kinematic_cell, kinematic_config

from policies.shipped import NamedPolicy
from tdpg_deploy.cell import GoalPixels
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode import run_episode
from tdpg_deploy.episode_log import software
from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.episode_log.writer import EpisodeWriter

# The first stands at the border.
BOXES = (Box(x=0.31, y=0.0), Box(x=0.5, y=0.1, height=0.04), Box(x=0.55, y=-0.1, height=0.07))


def cell_config(actions: int) -> CellConfig:
    config = kinematic_config()
    episode = config.episode.model_copy(update={"max_actions": actions})
    limits = config.limits.model_copy(update={"workspace_margin": 0.0})
    return config.model_copy(update={"episode": episode, "limits": limits})


def write_log(
    path: Path,
    policy: NamedPolicy,
    *,
    actions: int,
    seed: int = 3,
    slippery: bool = False,
    goal_pixels: GoalPixels | None = None,
) -> Episode:
    """slippery: nothing stays in the gripper, so that every grasp is futile."""
    config = cell_config(actions)
    table = Table(config, *BOXES, slippery=slippery)
    about = About(
        cell=config,
        policy=policy.name,
        checkpoint_sha256=policy.sha256,
        started_at=1_764_000_000.25,
        seed=seed,
        command="pytest",
        commit="0123456789abcdef",
        versions=software.versions(),
    )
    with EpisodeWriter(path, about, now=table.now) as log:
        run_episode(
            kinematic_cell(table, goal_pixels=goal_pixels),
            policy.decider,
            rng=np.random.default_rng(seed),
            log=log,
            goal=goal_pixels is not None,
        )
    return read_episode(path)
