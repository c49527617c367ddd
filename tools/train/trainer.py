"""The training loop: rounds of playing with frozen weights, then learning, then saving.

Everything that decides a round follows from the experiment's seed, the round's number and the
state saved after the round before, so a run that was killed goes on as if it had not been.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch

from policies.checkpoint import PolicyConfig, save_checkpoint
from policies.networks.light import LightNet
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.errors import ConfigError
from tools.train.config import TrainConfig
from tools.train.learner import Learner
from tools.train.replay import Replay
from tools.train.rollout import Experience, RolloutTask, play

STATE = "state.pt"
WEIGHTS = "policy.safetensors"
CURVE = "curve.jsonl"


@dataclass(frozen=True, kw_only=True)
class Progress:
    """One line of the curve. success: share of this round's actions that succeeded."""

    round: int
    actions: int
    updates: int
    success: float
    huber: float
    bce: float


def train(config: TrainConfig, directory: Path, *, on_progress: Callable[[Progress], None]) -> Path:
    """Train, or go on with what `directory` holds. Returns the frozen policy's file.

    Raises ConfigError when the directory belongs to another experiment.
    """
    directory.mkdir(parents=True, exist_ok=True)
    _claim(directory, config)
    run = _Run(config, directory)
    cell = training_cell()
    with ProcessPoolExecutor(
        config.rollout.workers, mp_context=get_context("spawn"), initializer=_quiet
    ) as workers:
        while run.replay.size < config.actions:
            run.freeze()
            tasks = list(run.tasks(cell))
            on_progress(run.learn(list(workers.map(play, tasks))))
            run.save()
    return run.freeze()


def training_cell() -> CellConfig:
    """The mock cell with a gantry in place of the arm, in a hurry, and the smaller picture."""
    cell = load_cell(DEFAULT_CELL)
    hurry = {
        "travel_speed": 1.0,
        "acceleration": 5.0,
        "joint_speed": 3.1,
        "joint_acceleration": 10.0,
    }
    return cell.model_copy(
        update={
            "camera": cell.camera.model_copy(update={"width": 640}),
            "simulation": cell.simulation.model_copy(update={"carrier": "gantry"}),
            "limits": cell.limits.model_copy(update=hurry),
        }
    )


def _claim(directory: Path, config: TrainConfig) -> None:
    file = directory / "experiment.json"
    mine = config.model_dump_json(indent=2)
    if not file.exists():
        file.write_text(mine, encoding="utf-8")
    elif json.loads(file.read_text(encoding="utf-8")) != json.loads(mine):
        raise ConfigError(
            f"{directory} holds another experiment (see {file}): give another --out, "
            "or the configuration that it was started with"
        )


def _quiet() -> None:
    """Ctrl-C is the parent's to handle."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


class _Run:
    def __init__(self, config: TrainConfig, directory: Path) -> None:
        self._config = config
        self._directory = directory
        round_size = config.rollout.workers * config.rollout.actions
        self.replay = Replay(directory / "replay", 2 * (config.actions + round_size))
        torch.manual_seed(config.seed)
        self._policy = PolicyConfig(
            network="light", width=config.width, goal=False, method="grasp-only"
        )
        network = LightNet(goal=self._policy.goal, width=self._policy.width)
        self._learner = Learner(network, config.learning)
        self._round = 0
        self._updates = 0
        file = directory / STATE
        if file.exists():
            state = torch.load(file, weights_only=True)
            self._learner.restore(state["learner"])
            self.replay.restore(state["replay"])
            self._round, self._updates = state["round"], state["updates"]

    @property
    def _done(self) -> float:
        """Share of the run, 0 to 1."""
        return min(1.0, self.replay.size / self._config.actions)

    def freeze(self) -> Path:
        """The weights as they are now, as a policy file."""
        path = self._directory / WEIGHTS
        provenance = {
            "command": f"tdpg-train --stage {self._config.stage}",
            "experiment": self._config.model_dump(mode="json"),
            "actions": self.replay.size,
            "updates": self._updates,
        }
        save_checkpoint(path, self._learner.network, self._policy, provenance)
        return path

    def tasks(self, cell: CellConfig) -> Iterator[RolloutTask]:
        rollout = self._config.rollout
        epsilon = rollout.epsilon_start + self._done * (rollout.epsilon_end - rollout.epsilon_start)
        for worker in range(rollout.workers):
            yield RolloutTask(
                weights=self._directory / WEIGHTS,
                cell=cell,
                randomization=self._config.randomization,
                seed=(self._config.seed, self._round, worker),
                actions=rollout.actions,
                objects=(rollout.min_objects, rollout.max_objects),
                epsilon=epsilon,
            )

    def learn(self, experiences: list[Experience]) -> Progress:
        for experience in experiences:
            self.replay.extend(experience.heights, experience.colors, experience.transitions)
        learning = self._config.learning
        rng = np.random.default_rng((self._config.seed, self._round))
        importance = learning.importance_exponent + self._done * (1 - learning.importance_exponent)
        gained = sum(len(experience.transitions) for experience in experiences)
        updates = int(gained * learning.updates_per_action)
        if self.replay.size < learning.warmup:
            updates = 0
        self._learner.set_learning_rate(self._learning_rate())
        losses = [
            self._learner.update(self.replay, rng, importance=importance) for _ in range(updates)
        ]
        self._updates += updates
        rewards = np.concatenate([experience.transitions["reward"] for experience in experiences])

        def mean(name: str) -> float:
            return float(np.mean([loss[name] for loss in losses])) if losses else float("nan")

        progress = Progress(
            round=self._round,
            actions=self.replay.size,
            updates=self._updates,
            success=float(rewards.mean()),
            huber=mean("huber"),
            bce=mean("bce"),
        )
        self._round += 1
        return progress

    def _learning_rate(self) -> float:
        first, last = (
            self._config.learning.learning_rate,
            self._config.learning.last_learning_rate,
        )
        return last + (first - last) * (1 + math.cos(math.pi * self._done)) / 2

    def save(self) -> None:
        """All at once: a kill leaves the state of this round or of the one before."""
        part = self._directory / (STATE + ".part")
        torch.save(
            {
                "learner": self._learner.state(),
                "replay": self.replay.state(),
                "round": self._round,
                "updates": self._updates,
            },
            part,
        )
        os.replace(part, self._directory / STATE)
