"""The training loop: a round is played with frozen weights while the one before is learnt from.

Everything that decides a round follows from the experiment's seed, the round's number and the
state saved after the round before, so a run that was killed goes on as if it had not been.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.sim.hurry import in_a_hurry
from tools.pool import process_pool
from tools.train.claim import claim
from tools.train.config import TrainConfig
from tools.train.curve import Curve, Progress
from tools.train.judge import judge, summed_up
from tools.train.rollout import play
from tools.train.run import Run


def train(config: TrainConfig, directory: Path, *, on_progress: Callable[[Progress], None]) -> Path:
    """Train, or go on with what `directory` holds. Returns the frozen policy's file.

    Raises ConfigError when the directory belongs to another experiment.
    """
    claim(directory, config.model_dump(mode="json"))
    run = Run(config, directory)
    cell = training_cell()
    torch.set_num_threads(1)  # the other cores play
    with (
        process_pool(config.rollout.workers) as workers,
        Curve(directory, round=run.round) as curve,
    ):
        tasks = [] if run.done else run.tasks(cell)
        playing = workers.map(play, tasks)
        while not run.done:
            played, experiences = tasks, list(playing)
            run.remember(played, experiences)
            if not run.done:
                tasks = run.tasks(cell)
                playing = workers.map(play, tasks)
            progress = run.learn(played, experiences)
            judged = workers.map(judge, run.judgements(cell, played))
            progress = replace(progress, validation=summed_up(list(judged)))
            curve.add(progress)
            run.save()
            on_progress(progress)
    return run.freeze()


def training_cell() -> CellConfig:
    """The mock cell with a gantry in place of the arm, in a hurry, and the smaller picture."""
    return in_a_hurry(load_cell(DEFAULT_CELL))
