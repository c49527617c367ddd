"""GI's coordinator on the real simulator, at the smallest size that has all of its parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from policies.checkpoint import PolicyConfig, load_checkpoint, save_checkpoint
from policies.coordinator import GRASP, PUSH, Coordinator
from policies.networks.light import LightNet
from tdpg_deploy.errors import ConfigError
from tools.train import coordinate
from tools.train.config import CoordinatorCourse
from tools.train.coordinate import CoinTask, judged, teach, teach_coordinator, toss
from tools.train.export import export
from tools.train.trainer import training_cell


def course_from(start: Path | None) -> CoordinatorCourse:
    return CoordinatorCourse(
        course="coordinator", seed=1, grasps=4, updates=20, batch=4, start=start
    )


def policy(path: Path, *, goal: bool) -> Path:
    """Of fresh weights."""
    torch.manual_seed(0)
    config = PolicyConfig(network="light", width=4, goal=goal, method="tdpg")
    save_checkpoint(path, LightNet(goal=goal, width=4), config, {"actions": 5})
    return path


def test_it_learns_which_situations_end_well() -> None:
    """Grasps succeed, for the test, where less than a third of the border is occupied."""
    rng = np.random.default_rng(0)
    situations = torch.from_numpy(rng.uniform(0, 1, (1000, 5)).astype(np.float32))
    succeeded = torch.where(situations[:, 2] < 0.3, GRASP, PUSH)
    torch.manual_seed(0)
    coordinator = Coordinator()
    course = course_from(None).model_copy(update={"updates": 1000, "batch": 64})
    teach(coordinator, situations[:800], succeeded[:800], course)
    validation = judged(coordinator, situations[800:], succeeded[800:])
    assert validation["succeeded"] == pytest.approx(0.3, abs=0.08)
    assert validation["foretold"] is not None
    assert validation["foretold"] > 0.95
    never = judged(coordinator, situations[succeeded == PUSH][:5] + 9, succeeded[:5])
    assert (never["made"], never["succeeded of those made"]) == (0, None)


@pytest.mark.slow
def test_a_course_ends_in_a_policy_that_is_coordinated(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(coordinate, "RECORD", 2)
    start = policy(tmp_path / "critics.safetensors", goal=True)
    told: list[tuple[object, ...]] = []

    def tell(*progress: object) -> None:
        told.append(progress)

    out = tmp_path / "gi"
    path = teach_coordinator(course_from(start), out, on_progress=tell)
    assert told == [("grasps made", 2, 4), ("grasps made", 4, 4)]
    frozen = load_checkpoint(path)
    assert (frozen.config.network, frozen.config.method) == ("coordinated", "gi")
    light = load_checkpoint(start).weights
    assert all(torch.equal(frozen.weights[f"light.{name}"], light[name]) for name in light)
    assert 0 <= frozen.provenance["validation"]["foretold"] <= 1
    again = teach_coordinator(course_from(start), out, on_progress=tell)  # from the same records
    assert load_checkpoint(again).sha256 == frozen.sha256
    export(out, tmp_path / "gi.safetensors")
    assert "foretold" in (tmp_path / "gi.md").read_text()
    other = policy(tmp_path / "other.safetensors", goal=True)
    with pytest.raises(ConfigError, match="holds another experiment"):
        teach_coordinator(course_from(other), out, on_progress=tell)


@pytest.mark.slow
def test_the_same_task_tosses_the_same_coins(tmp_path: Path) -> None:
    weights = policy(tmp_path / "critics.safetensors", goal=True)
    records = []
    for name in ("one", "other"):
        task = CoinTask(
            weights=weights,
            cell=training_cell(),
            randomization=course_from(None).randomization,
            seed=(3, 1),
            grasps=2,
            file=tmp_path / f"{name}.npz",
        )
        with np.load(toss(task), allow_pickle=False) as record:
            records.append((record["situations"], record["succeeded"]))
    for one, other in zip(*records, strict=True):
        np.testing.assert_array_equal(one, other)
    assert records[0][0].shape[1] == 5


def test_it_needs_critics_that_know_a_goal(tmp_path: Path) -> None:
    clears = policy(tmp_path / "clears.safetensors", goal=False)
    for start, message in ((None, "give --from FILE"), (clears, "goal is False")):
        with pytest.raises(ConfigError, match=message):
            teach_coordinator(course_from(start), tmp_path, on_progress=print)
