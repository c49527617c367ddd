"""One episode on one cell with its log: what tdpg-run and tdpg-eval do alike."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calibration.drift import TagCorners, check_still, find_tags
from policies.shipped import NamedPolicy
from tdpg_deploy.calibration_file import check_applies
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode import Confirm, run_episode
from tdpg_deploy.episode_log import software
from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.writer import EpisodeWriter
from tdpg_deploy.episode_record import EpisodeRecorder, EpisodeResult
from tdpg_deploy.sim.scene_file import format_scene
from tdpg_deploy.sim.scenes import Scene

Watch = Callable[[EpisodeRecorder], EpisodeRecorder]


def log_episode(
    config: CellConfig,
    policy: NamedPolicy,
    path: Path,
    *,
    seed: int,
    real: bool = False,
    scene: Scene | None = None,
    goal: bool = False,
    watch: Watch = lambda recorder: recorder,
    confirm: Confirm | None = None,
) -> EpisodeResult:
    """Run one episode and leave its log at `path`.

    scene: what lies on a simulated table. watch: puts a listener before the log's writer.
    confirm: asked before each action. Raises what open_cell, check_calibration and run_episode
    raise.
    """
    about = About(
        cell=config,
        policy=policy.name,
        checkpoint_sha256=policy.sha256,
        started_at=time.time(),
        seed=seed,
        command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        scene=None if scene is None else format_scene(scene),
        commit=software.commit(),
        versions=software.versions(),
    )
    with open_cell(config, real=real, scene=scene, seed=seed) as cell:
        check_calibration(cell)
        with EpisodeWriter(path, about, now=cell.clock.now) as log:
            return run_episode(
                cell,
                policy.decider,
                rng=np.random.default_rng(seed),
                log=watch(log),
                goal=goal,
                confirm=confirm,
            )


def check_calibration(cell: Cell) -> None:
    """Before anything moves, by one frame: that the calibration which the cell file names is this
    camera's and not stale, and that the table tags are where they were. Nothing is checked of a
    pose that was typed in. Raises CalibrationError.
    """
    calibration = cell.config.camera.calibration
    if calibration is None:
        return
    frame = cell.camera.capture()
    height, width = frame.color.shape[:2]
    check_applies(calibration, serial=frame.serial, width=width, height=height)
    if calibration.tags:
        before = TagCorners(corners=calibration.tag_corners())
        check_still(before, find_tags(frame.color))
