"""The training loop: a round is played with frozen weights while the one before is learnt from.

Everything that decides a round follows from the experiment's seed, the round's number and the
state saved after the round before, so a run that was killed goes on as if it had not been.
"""

from __future__ import annotations

import copy
import json
import math
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

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
    torch.set_num_threads(1)  # the other cores play
    with ProcessPoolExecutor(
        config.rollout.workers, mp_context=get_context("spawn"), initializer=_quiet
    ) as workers:
        playing = workers.map(play, run.tasks(cell))
        while not run.done:
            gained = run.remember(list(playing))
            if not run.done:
                playing = workers.map(play, run.tasks(cell))
            progress = run.learn(gained)
            run.save()
            on_progress(progress)
    return run.freeze()


def training_cell() -> CellConfig:
    """The mock cell with a gantry in place of the arm, in a hurry, and the smaller picture."""
    cell = load_cell(DEFAULT_CELL)
    hurry = {
        "travel_speed": 1.0,
        "contact_speed": 0.25,
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
    """What a run has come to. `actor`: the weights that play the round after the last one
    remembered; they have not learnt from that one yet."""

    def __init__(self, config: TrainConfig, directory: Path) -> None:
        self._config = config
        self._directory = directory
        round_size = config.rollout.workers * config.rollout.actions
        self._replay = Replay(directory / "replay", 2 * (config.actions + round_size))
        self._policy = PolicyConfig(
            network="light", width=config.width, goal=False, method="grasp-only"
        )
        torch.manual_seed(config.seed)
        self._actor = LightNet(goal=False, width=config.width)
        self._learner = Learner(copy.deepcopy(self._actor), config.learning)
        self._round = 0
        self._updates = 0
        file = directory / STATE
        if file.exists():
            state = torch.load(file, weights_only=True)
            self._actor.load_state_dict(state["actor"])
            self._learner.restore(state["learner"])
            self._replay.restore(state["replay"])
            self._round, self._updates = state["round"], state["updates"]

    @property
    def done(self) -> bool:
        return self._replay.size >= self._config.actions

    @property
    def _share(self) -> float:
        """Of the run that is done, 0 to 1."""
        return min(1.0, self._replay.size / self._config.actions)

    def freeze(self) -> Path:
        """The weights learnt so far, as a policy file with its provenance."""
        path = self._directory / WEIGHTS
        save_checkpoint(path, self._learner.network, self._policy, self._provenance())
        return path

    def tasks(self, cell: CellConfig) -> list[RolloutTask]:
        """The next round."""
        weights = self._directory / f"playing-{self._round % 2}.safetensors"
        save_checkpoint(weights, self._actor, self._policy, self._provenance())
        rollout = self._config.rollout
        return [
            RolloutTask(
                weights=weights,
                cell=cell,
                randomization=self._config.randomization,
                seed=(self._config.seed, self._round, worker),
                actions=rollout.actions,
                objects=(rollout.min_objects, rollout.max_objects),
                epsilon=_between(rollout.epsilon_start, rollout.epsilon_end, self._share),
            )
            for worker in range(rollout.workers)
        ]

    def remember(self, experiences: list[Experience]) -> list[Experience]:
        """End a round: keep what was lived through, and let the next one be played with what
        has been learnt up to here."""
        for experience in experiences:
            self._replay.extend(experience.heights, experience.colors, experience.transitions)
        self._actor = copy.deepcopy(self._learner.network)
        self._round += 1
        return experiences

    def learn(self, gained: list[Experience]) -> Progress:
        """As many updates as the round's actions pay for."""
        learning = self._config.learning
        rewards = np.concatenate([experience.transitions["reward"] for experience in gained])
        updates = int(len(rewards) * learning.updates_per_action)
        if self._replay.size < learning.warmup:
            updates = 0
        self._learner.set_learning_rate(self._learning_rate())
        importance = _between(learning.importance_exponent, 1.0, self._share)
        rng = np.random.default_rng((self._config.seed, self._round))
        losses = [
            self._learner.update(self._replay, rng, importance=importance) for _ in range(updates)
        ]
        self._updates += updates
        return Progress(
            round=self._round,
            actions=self._replay.size,
            updates=self._updates,
            success=float(rewards.mean()),
            huber=_mean([loss["huber"] for loss in losses]),
            bce=_mean([loss["bce"] for loss in losses]),
        )

    def save(self) -> None:
        """All at once: a kill leaves the state of this round or of the one before."""
        state = {
            "actor": self._actor.state_dict(),
            "learner": self._learner.state(),
            "replay": self._replay.state(),
            "round": self._round,
            "updates": self._updates,
        }
        part = self._directory / (STATE + ".part")
        torch.save(state, part)
        os.replace(part, self._directory / STATE)

    def _learning_rate(self) -> float:
        learning = self._config.learning
        half_cosine = (1 - math.cos(math.pi * self._share)) / 2
        return _between(learning.learning_rate, learning.last_learning_rate, half_cosine)

    def _provenance(self) -> dict[str, Any]:
        return {
            "command": f"tdpg-train --stage {self._config.stage}",
            "experiment": self._config.model_dump(mode="json"),
            "actions": self._replay.size,
            "updates": self._updates,
        }


def _between(first: float, last: float, share: float) -> float:
    return first + (last - first) * share


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
