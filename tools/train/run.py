"""What a training run has come to, and how it is saved: weights, optimiser, experience."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F

from policies.checkpoint import Checkpoint, PolicyConfig, load_checkpoint, save_checkpoint
from policies.methods import METHODS
from policies.networks.build import ENTRANCES, build
from policies.networks.maps import Network
from policies.networks.two_towers import TwoTowerNet
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode_log import software
from tdpg_deploy.errors import ConfigError
from tools.train.config import (
    CoordinatorCourse,
    GraspCourse,
    PushCourse,
    Stage,
    StageKind,
    TrainConfig,
    stage_after,
)
from tools.train.curve import Progress
from tools.train.judge import JudgeTask
from tools.train.learner import Learner
from tools.train.notebook import Experience
from tools.train.replay import Replay
from tools.train.rollout import RolloutTask
from tools.train.whole import written_whole

STATE = "state.pt"
WEIGHTS = "policy.safetensors"


class Run:
    """`_actor`: the weights that play the round after the last one remembered; they have not
    learnt from that one yet. `_played`: actions that were asked for, round by round: the place
    in the experiment."""

    def __init__(self, config: TrainConfig, directory: Path) -> None:
        """Begin, or go on with what `directory` holds. Raises ConfigError when the weights to
        start with do not fit."""
        self._config = config
        self._directory = directory
        capacity = 2 * config.actions  # a transition keeps two looks at most
        self._replay = Replay(directory / "replay", capacity, goal=config.goal)
        torch.manual_seed(config.seed)
        network = build(config.network, goal=config.goal, width=config.width)
        self.round = 0
        self._played = 0
        self._updates = 0
        self._start: dict[str, Any] | None = None
        self._actor = network
        self._learner = Learner(
            copy.deepcopy(network),
            config.learning,
            critic_two=METHODS[config.method].judge is not None,
        )
        file = directory / STATE
        if file.exists():
            state = torch.load(file, weights_only=True)
            self._actor.load_state_dict(state["actor"])
            self._learner.restore(state["learner"])
            self._replay.restore(state["replay"])
            self.round, self._played = state["round"], state["played"]
            self._updates = state["updates"]
            self._start = state["start"]
        elif config.start is not None:
            weights, self._start = _begin_with(config.start, self._policy("grasp"))
            self._actor.load_state_dict(weights)
            self._learner.network.load_state_dict(weights)
        elif config.imagenet is not None:
            assert isinstance(network, TwoTowerNet)
            _load_imagenet(network, config.imagenet)
            self._learner.network.load_state_dict(network.state_dict())

    @property
    def done(self) -> bool:
        return self._played >= self._config.actions

    def freeze(self) -> Path:
        """The weights learnt so far, as a policy file with its provenance."""
        stage = self._config.stages[-1] if self.done else self._stage()[0]
        path = self._directory / WEIGHTS
        self._save_policy(path, self._learner.network, stage.kind)
        return path

    def tasks(self, cell: CellConfig) -> list[RolloutTask]:
        """The next round."""
        config, rollout = self._config, self._config.rollout
        stage, left = self._stage()
        weights = self._directory / f"playing-{self.round % 2}.safetensors"
        self._save_policy(weights, self._actor, stage.kind)
        return [
            RolloutTask(
                weights=weights,
                cell=cell,
                randomization=config.randomization,
                push_reward=config.push_reward,
                stage=stage,
                seed=(config.seed, self.round, worker),
                actions=actions,
                epsilon=self._epsilon(),
            )
            for worker, actions in enumerate(shares(left, rollout.workers, rollout.actions))
        ]

    def remember(self, tasks: Sequence[RolloutTask], experiences: Sequence[Experience]) -> None:
        """End a round: keep what was lived through, and let the next one be played with what
        has been learnt up to here."""
        for experience in experiences:
            self._replay.extend(
                experience.heights, experience.colors, experience.transitions, experience.goals
            )
        self._played += sum(task.actions for task in tasks)
        self._actor = copy.deepcopy(self._learner.network)
        self.round += 1

    def learn(self, tasks: Sequence[RolloutTask], experiences: Sequence[Experience]) -> Progress:
        """As many updates as the round's actions pay for."""
        learning = self._config.learning
        gained = np.concatenate([experience.transitions for experience in experiences])
        updates = int(len(gained) * learning.updates_per_action)
        if self._replay.size < learning.warmup:
            updates = 0
        rate = self._learning_rate()
        self._learner.set_learning_rate(rate)
        importance = _between(learning.importance_exponent, 1.0, self._share)
        rng = np.random.default_rng((self._config.seed, self.round))
        losses = [
            self._learner.update(self._replay, rng, importance=importance) for _ in range(updates)
        ]
        self._updates += updates
        return Progress(
            round=self.round,
            stage=tasks[0].stage.kind,
            actions=self._played,
            updates=self._updates,
            epsilon=tasks[0].epsilon,
            learning_rate=rate,
            grasp_success=_mean(gained["grasped"][gained["grasped"] >= 0]),
            push_reward=_mean(gained["reward"][gained["push"]]),
            huber=_mean([loss["huber"] for loss in losses]),
            bce=_mean([loss["bce"] for loss in losses]),
            td_error=_mean([loss["td_error"] for loss in losses]),
            validation=None,
        )

    def judgements(self, cell: CellConfig, tasks: Sequence[RolloutTask]) -> list[JudgeTask]:
        """The episodes to judge by, if they are due after this round's tasks."""
        evaluation = self._config.evaluation
        before = self._played - sum(task.actions for task in tasks)
        if before // evaluation.every == self._played // evaluation.every:
            return []
        weights = self.freeze()
        return [
            JudgeTask(
                weights=weights,
                cell=cell,
                objects=evaluation.objects,
                seed=evaluation.seed + episode,
            )
            for episode in range(evaluation.episodes)
        ]

    def save(self) -> None:
        """All at once: a kill leaves the state of this round or of the one before."""
        state = {
            "actor": self._actor.state_dict(),
            "learner": self._learner.state(),
            "replay": self._replay.state(),
            "round": self.round,
            "played": self._played,
            "updates": self._updates,
            "start": self._start,
        }
        with written_whole(self._directory / STATE) as file:
            torch.save(state, file)
        self.freeze()

    @property
    def _share(self) -> float:
        """Of the run that is done, 0 to 1."""
        return min(1.0, self._played / self._config.actions)

    def _stage(self) -> tuple[Stage, int]:
        return stage_after(self._config, self._played)

    def _epsilon(self) -> float:
        rollout = self._config.rollout
        return _between(rollout.epsilon_start, rollout.epsilon_end, self._share)

    def _learning_rate(self) -> float:
        learning = self._config.learning
        half_cosine = (1 - math.cos(math.pi * self._share)) / 2
        return _between(learning.learning_rate, learning.last_learning_rate, half_cosine)

    def _policy(self, kind: StageKind) -> PolicyConfig:
        """How weights decide in a stage: Critic II has its say once there are two actions to
        choose from."""
        synergy = self._config.method
        method = {"grasp": "grasp-only", "push": "tdpg-base", "synergy": synergy}[kind]
        return PolicyConfig(
            network=self._config.network,
            width=self._config.width,
            goal=self._config.goal,
            method=method,
        )

    def _save_policy(self, path: Path, network: Network, kind: StageKind) -> None:
        provenance: dict[str, Any] = {
            "experiment": self._config.model_dump(mode="json", exclude={"start"}),
            "start": self._start,
            "actions": self._played,
            "updates": self._updates,
            "commit": software.commit(),
        }
        save_checkpoint(path, network, self._policy(kind), provenance)


def shares(left: int, workers: int, most: int) -> list[int]:
    """How many actions each worker makes in a round: `most`, or an even part of what is left."""
    total = min(left, workers * most)
    even = [total // workers + (worker < total % workers) for worker in range(workers)]
    return [actions for actions in even if actions]


def _begin_with(path: Path, policy: PolicyConfig) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Weights of a policy file, and their provenance: identity and actions learnt from so far.

    Weights that know no goal can learn to fetch one: the goal's channel begins at zero. Raises
    ConfigError when they are of another network.
    """
    start = load_checkpoint(path)
    for name in ("network", "width"):
        theirs, ours = getattr(start.config, name), getattr(policy, name)
        if theirs != ours:
            raise ConfigError(
                f"{path}: {name} is {theirs}, the experiment's is {ours}: start with weights of "
                "the same network"
            )
    weights = dict(start.weights)
    if start.config.goal and not policy.goal:
        raise ConfigError(f"{path}: these weights expect a goal, the experiment has none")
    if policy.goal and not start.config.goal:
        for name in ENTRANCES[policy.network]:
            weights[name] = F.pad(weights[name], (0, 0, 0, 0, 0, 1))
    return weights, started_with(start)


def started_with(start: Checkpoint) -> dict[str, Any]:
    """For the provenance: whose weights a run began with, and what those had learnt from."""
    earlier = start.provenance.get("start") or {"actions": 0}
    return {
        "sha256": start.sha256,
        "actions": start.provenance.get("actions", 0) + earlier["actions"],
    }


def provenance_of(
    course: PushCourse | GraspCourse | CoordinatorCourse,
    start: Checkpoint,
    *,
    actions: int,
    validation: Mapping[str, Any],
) -> dict[str, Any]:
    """Of what a course made of the policy `start`."""
    return {
        "experiment": course.model_dump(mode="json", exclude={"start"}),
        "start": started_with(start),
        "actions": actions,
        "updates": course.updates,
        "commit": software.commit(),
        "validation": validation,
    }


def _load_imagenet(network: TwoTowerNet, path: Path) -> None:
    """Raises ConfigError when the file is not torchvision's densenet121."""
    try:
        network.load_imagenet(torch.load(path, map_location="cpu", weights_only=True))
    except (OSError, EOFError, RuntimeError, UnpicklingError, AttributeError, KeyError) as error:
        raise ConfigError(f"{path}: not torchvision's densenet121 weights: {error}") from error


def _between(first: float, last: float, share: float) -> float:
    return first + (last - first) * share


def _mean(values: Sequence[float] | npt.NDArray[np.float32]) -> float | None:
    return float(np.mean(values)) if len(values) else None
