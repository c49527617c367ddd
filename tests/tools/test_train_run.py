"""The training loop on the real simulator, at the smallest size that has all of its parts."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from policies.checkpoint import PolicyConfig, load_checkpoint, save_checkpoint
from policies.networks.densenet import DenseNet121
from policies.networks.light import LightNet
from tdpg_deploy.errors import ConfigError
from tools.train import trainer
from tools.train.cli import EXPERIMENTS
from tools.train.config import (
    CoordinatorCourse,
    Evaluation,
    GraspCourse,
    Learning,
    PushCourse,
    PushReward,
    Randomization,
    Rollout,
    Stage,
    TrainConfig,
    load_experiment,
    overridden,
    stage_after,
)
from tools.train.curve import Progress, read_curve
from tools.train.replay import Replay, unpack_goal
from tools.train.rollout import RolloutTask, play
from tools.train.run import Run, shares

SMALL = TrainConfig(
    width=4,
    stages=(
        Stage(kind="grasp", actions=3, min_objects=2, max_objects=3),
        Stage(kind="push", actions=4, min_objects=4, max_objects=4),
        Stage(kind="synergy", actions=3, min_objects=3, max_objects=3),
    ),
    rollout=Rollout(workers=1, actions=4),
    learning=Learning(batch=4, warmup=2, updates_per_action=0.5, next_grasps=2),
    evaluation=Evaluation(every=10, episodes=1, objects=1),
)


@pytest.mark.slow
def test_a_run_that_was_killed_ends_like_one_that_was_not(tmp_path: Path) -> None:
    whole: list[Progress] = []
    straight = trainer.train(SMALL, tmp_path / "straight", on_progress=whole.append)

    def killed(progress: Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trainer.train(SMALL, tmp_path / "killed", on_progress=killed)
    rest: list[Progress] = []
    resumed = trainer.train(SMALL, tmp_path / "killed", on_progress=rest.append)

    assert [(line.stage, line.actions) for line in whole] == [
        ("grasp", 3),
        ("push", 7),
        ("synergy", 10),
    ]
    assert [line.validation is not None for line in whole] == [False, False, True]
    assert rest == whole[1:]
    lines = read_curve(tmp_path / "killed")
    assert lines == [dataclasses.asdict(line) for line in whole]
    expected, actual = load_checkpoint(straight).weights, load_checkpoint(resumed).weights
    for name, weight in expected.items():
        torch.testing.assert_close(actual[name], weight, rtol=0, atol=0)
    assert load_checkpoint(straight).config.method == "tdpg"


@pytest.mark.slow
def test_the_same_task_gives_the_same_experience(tmp_path: Path) -> None:
    torch.manual_seed(0)
    config = PolicyConfig(network="light", width=4, goal=False, method="grasp-only")
    save_checkpoint(tmp_path / "p", LightNet(goal=False, width=4), config, {})
    task = RolloutTask(
        weights=tmp_path / "p",
        cell=trainer.training_cell(),
        randomization=Randomization(),
        seed=(3, 1),
        push_reward=PushReward(),
        stage=Stage(kind="grasp", actions=3, min_objects=3, max_objects=3),
        actions=3,
        epsilon=0.5,
    )
    first, again = play(task), play(task)
    np.testing.assert_array_equal(first.heights, again.heights)
    np.testing.assert_array_equal(first.transitions, again.transitions)
    other = play(dataclasses.replace(task, seed=(3, 2)))
    assert not np.array_equal(first.heights[0], other.heights[0])


@pytest.mark.slow
def test_goals_are_fetched_one_after_another(tmp_path: Path) -> None:
    """Paper, section III-D, from weights that knew no goal."""
    torch.manual_seed(0)
    agnostic = PolicyConfig(network="light", width=4, goal=False, method="grasp-only")
    network = LightNet(goal=False, width=4)
    sha256 = save_checkpoint(tmp_path / "start.safetensors", network, agnostic, {"actions": 7})
    config = overridden(
        TrainConfig(
            width=4,
            goal=True,
            stages=(Stage(kind="grasp", actions=4, min_objects=2, max_objects=2),),
            rollout=Rollout(workers=1, actions=4),
            learning=Learning(batch=4, warmup=100),
            evaluation=Evaluation(episodes=0),
        ),
        start=tmp_path / "start.safetensors",
    )
    policy = load_checkpoint(trainer.train(config, tmp_path / "run", on_progress=lambda _: None))
    assert policy.config.goal
    assert policy.provenance["start"] == {"sha256": sha256, "actions": 7}
    stem = policy.weights["stem.weight"]
    torch.testing.assert_close(stem[:, :6], network.stem.weight.detach(), rtol=0, atol=0)
    assert not stem[:, 6].any()
    replay = Replay(tmp_path / "run" / "replay", 2 * config.actions, goal=True)
    assert replay.goals is not None
    looks = replay.transitions["look"][: config.actions]
    shown = [unpack_goal(replay.goals[look]).sum() for look in looks]
    assert all(30 <= pixels < 5000 for pixels in shown)  # a block's face; the limit of viability


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    config = PolicyConfig(network="light", width=8, goal=False, method="grasp-only")
    save_checkpoint(tmp_path / "p", LightNet(goal=False, width=8), config, {})
    with pytest.raises(ConfigError, match="width is 8, the experiment's is 4"):
        Run(SMALL.model_copy(update={"start": tmp_path / "p"}), tmp_path)


def test_both_towers_begin_with_imagenet_weights(tmp_path: Path) -> None:
    torch.manual_seed(0)
    tower = DenseNet121()
    torch.save(tower.state_dict(), tmp_path / "densenet121.pth")
    config = overridden(
        SMALL.model_copy(update={"network": "densenet121", "width": 32}),
        imagenet=tmp_path / "densenet121.pth",
    )
    weights = load_checkpoint(Run(config, tmp_path / "run").freeze()).weights
    expected = tower.state_dict()["features.denseblock1.denselayer1.conv1.weight"]
    for name in ("color_tower", "depth_tower"):
        actual = weights[f"{name}.features.denseblock1.denselayer1.conv1.weight"]
        torch.testing.assert_close(actual, expected, rtol=0, atol=0)


@pytest.mark.parametrize("content", [b"", b"not weights", None])
def test_what_is_no_densenet_is_refused(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "densenet121.pth"
    if content is None:
        torch.save({"features.conv0.weight": torch.zeros(64, 3, 7, 7)}, file)
    else:
        file.write_bytes(content)
    config = SMALL.model_copy(update={"network": "densenet121", "width": 32, "imagenet": file})
    with pytest.raises(ConfigError, match="not torchvision's densenet121"):
        Run(config, tmp_path / "run")


def test_a_width_that_the_network_cannot_have_is_refused() -> None:
    with pytest.raises(ConfigError, match="width = 4 is not within 32 to 32 for densenet121"):
        overridden(SMALL.model_copy(update={"network": "densenet121"}))
    with pytest.raises(ConfigError, match="imagenet weights are densenet121's"):
        overridden(SMALL, imagenet=Path("densenet121.pth"))


def test_stages_follow_each_other() -> None:
    assert SMALL.actions == 10
    kinds = [(stage_after(SMALL, n)[0].kind, stage_after(SMALL, n)[1]) for n in (0, 2, 3, 9)]
    assert kinds == [("grasp", 3), ("grasp", 1), ("push", 4), ("synergy", 1)]


def test_a_round_asks_for_no_more_than_is_left() -> None:
    assert shares(100, 2, 24) == [24, 24]
    assert shares(5, 2, 24) == [3, 2]
    assert shares(1, 2, 24) == [1]


def test_the_paper_s_budget() -> None:
    """Section III-D: 4,000 steps, 1,000 for stages I and II and 2,000 for stage III."""
    for name in ("tdpg", "tdpg-goal"):
        config = load_experiment(EXPERIMENTS / f"{name}.toml")
        assert isinstance(config, TrainConfig)
        assert [(s.kind, s.actions) for s in config.stages] == [
            ("grasp", 1000),
            ("push", 1000),
            ("synergy", 2000),
        ]
        assert [s.max_objects for s in config.stages][:2] == [10, 20]
        learning = config.learning
        assert (learning.learning_rate, learning.betas) == (1e-4, (0.9, 0.99))
        assert (learning.discount, learning.weight_decay) == (0.5, 2e-5)


def test_a_directory_belongs_to_one_experiment(tmp_path: Path) -> None:
    (tmp_path / "experiment.json").write_text('{"stage": "other"}')
    with pytest.raises(ConfigError, match="another experiment"):
        trainer.train(SMALL, tmp_path, on_progress=lambda _: None)


@pytest.mark.parametrize("file", sorted(EXPERIMENTS.glob("*.toml")), ids=lambda file: file.stem)
def test_the_shipped_experiments_are_valid(file: Path) -> None:
    courses = {"pushes": PushCourse, "grasps": GraspCourse, "gi": CoordinatorCourse}
    kind = courses.get(file.stem, TrainConfig)
    assert isinstance(load_experiment(file), kind)


def test_a_wrong_experiment_names_the_field(tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text("[learning]\ndiscount = 2.0\n")
    with pytest.raises(ConfigError, match=r"learning.discount"):
        load_experiment(file)
