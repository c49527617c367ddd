"""A course of pushes on the real simulator, at the smallest size that has all of its parts."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import scipy.ndimage
import torch
from pydantic import ValidationError

from policies.checkpoint import PolicyConfig, load_checkpoint, save_checkpoint
from policies.networks.light import LightNet
from policies.networks.twin import PushNet
from policies.networks.two_towers import TwoTowerNet
from policies.standing import RISE
from tdpg_deploy.choosing import GOAL_PIXELS
from tdpg_deploy.errors import ConfigError
from tools.train import hold_out, teach
from tools.train.config import PushCourse, PushRound, Randomization
from tools.train.curve import read_curve
from tools.train.pushes import course as courses
from tools.train.pushes.course import teach_pushes
from tools.train.pushes.play import (
    HEMMED_IN,
    PUSHES_A_LOOK,
    PushRecord,
    PushTask,
    play_pushes,
)
from tools.train.replay import unpack_height
from tools.train.trainer import training_cell


@pytest.fixture
def grasps(tmp_path: Path) -> Path:
    """A policy that grasps, on fresh weights."""
    torch.manual_seed(0)
    path = tmp_path / "grasps.safetensors"
    config = PolicyConfig(network="light", width=4, goal=False, method="tdpg-free")
    save_checkpoint(path, LightNet(goal=False, width=4), config, {"actions": 5})
    return path


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(courses, "RECORD", 6)
    monkeypatch.setattr(hold_out, "EVERY", 2)
    monkeypatch.setattr(teach, "EPOCH", 2)


def course_from(grasps: Path | None) -> PushCourse:
    rounds = (PushRound(pushes=18, updates=4), PushRound(pushes=12, updates=2, since=1))
    return PushCourse(course="pushes", seed=1, rounds=rounds, batch=2, start=grasps)


def task_for(file: Path, *, pushes: int) -> PushTask:
    return PushTask(
        cell=training_cell(), randomization=Randomization(), seed=(3, 1), pushes=pushes, file=file
    )


@pytest.mark.slow
def test_a_course_that_was_killed_ends_like_one_that_was_not(
    small: None, grasps: Path, tmp_path: Path
) -> None:
    course, told = course_from(grasps), []

    def tell(*progress: object) -> None:
        told.append(progress)

    straight = tmp_path / "straight"
    path = teach_pushes(course, straight, straight, on_progress=tell)
    assert told == [
        ("pushes played", 6, 30),
        ("pushes played", 12, 30),
        ("pushes played", 18, 30),
        ("updates", 2, 6),
        ("updates", 4, 6),
        ("pushes played", 24, 30),
        ("pushes played", 30, 30),
        ("updates", 6, 6),
    ]

    def killed(what: str, done: int, _total: int) -> None:
        if (what, done) == ("updates", 2):
            raise KeyboardInterrupt

    broken = tmp_path / "broken"
    broken.mkdir()
    for record in straight.glob("000[012].npz"):
        (broken / record.name).write_bytes(record.read_bytes())
    with pytest.raises(KeyboardInterrupt):
        teach_pushes(course, broken, broken, on_progress=killed)
    resumed = teach_pushes(course, broken, broken, on_progress=tell)
    assert read_curve(broken) == read_curve(straight)
    for record in straight.glob("*.npz"):
        assert (broken / record.name).read_bytes() == record.read_bytes()
    expected, actual = load_checkpoint(path), load_checkpoint(resumed)
    for name, weight in expected.weights.items():
        torch.testing.assert_close(actual.weights[name], weight, rtol=0, atol=0)

    frozen, start = expected, load_checkpoint(grasps)
    assert (frozen.config.network, frozen.config.method) == ("twin", "tdpg-free")
    for name, weight in start.weights.items():
        assert torch.equal(frozen.weights[f"light.{name}"], weight)
    assert frozen.provenance["start"] == {"sha256": start.sha256, "actions": 5}
    assert set(frozen.provenance["validation"]) == {"loss", "goal", "all"}

    other = tmp_path / "other"  # what was taught is not taught again
    shared = teach_pushes(course, other, straight, on_progress=tell)
    assert load_checkpoint(shared).sha256 == frozen.sha256


@pytest.mark.slow
def test_the_same_task_gives_the_same_record(tmp_path: Path) -> None:
    task = dataclasses.replace(task_for(tmp_path / "one.npz", pushes=4), compact=0.5)
    record = PushRecord.load(play_pushes(task))
    again = PushRecord.load(play_pushes(dataclasses.replace(task, file=tmp_path / "two.npz")))
    for field in dataclasses.fields(PushRecord):
        np.testing.assert_array_equal(getattr(record, field.name), getattr(again, field.name))
    assert len(record.pushes) >= 4
    assert record.pushes[:, 0].max() == len(record.heights) - 1
    for push, look in enumerate(record.pushes[:, 0]):
        there = np.arange(30) < record.objects[look]
        assert not (record.on_table_after[push] & ~there).any()
        assert not (record.free_after[push] & ~there).any()
        assert not (record.taken_after[push] & ~record.on_table_after[push]).any()
        assert record.stuck[look] or not record.taken_after[push].any()
    before = (tmp_path / "one.npz").stat().st_mtime_ns
    play_pushes(task)  # is there already
    assert (tmp_path / "one.npz").stat().st_mtime_ns == before


@pytest.mark.slow
def test_a_push_net_chooses_its_best_pushes(tmp_path: Path) -> None:
    """One on fresh weights: where all are worth the same it still takes three that are apart."""
    torch.manual_seed(0)
    torch.save(PushNet().state_dict(), tmp_path / "net.pt")
    task = dataclasses.replace(
        task_for(tmp_path / "one.npz", pushes=3), chooser=tmp_path / "net.pt"
    )
    record = PushRecord.load(play_pushes(task))
    assert len(np.unique(record.pushes, axis=0)) == len(record.pushes)


@pytest.mark.slow
@pytest.mark.parametrize("hard", [False, True])
def test_knots_are_looks_at_something_that_is_hemmed_in(hard: bool, tmp_path: Path) -> None:
    """And pushes are for its sake: they meet it or what stands near it. In hard ones until it is
    free."""
    task = dataclasses.replace(
        task_for(tmp_path / "knots.npz", pushes=8), compact=1.0, knots=True, hard=hard
    )
    record = PushRecord.load(play_pushes(task))
    for look, objects in enumerate(record.objects):
        owners, tall = record.owners[look], unpack_height(record.heights[look]) > RISE
        hemmed_in: dict[int, float] = {}
        for goal in np.flatnonzero(~record.free[look, :objects]).tolist():
            around = scipy.ndimage.binary_dilation(owners == goal, np.ones((11, 11), np.bool_))
            around &= owners != goal
            if (owners == goal).sum() >= GOAL_PIXELS:
                hemmed_in[goal] = float(tall[around].mean())
        goal = max(hemmed_in, key=hemmed_in.__getitem__)
        assert hemmed_in[goal] >= HEMMED_IN
        freed = record.free_after[record.pushes[:, 0] == look, goal]
        assert not (hard and freed[:-1].any())
    assert np.bincount(record.pushes[:, 0]).max() > PUSHES_A_LOOK


def test_a_course_begins_with_a_light_network(small: None, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="give --from"):
        teach_pushes(course_from(None), tmp_path, tmp_path, on_progress=print)
    dense = tmp_path / "dense.safetensors"
    config = PolicyConfig(network="densenet121", width=32, goal=False, method="tdpg")
    save_checkpoint(dense, TwoTowerNet(goal=False), config, {})
    with pytest.raises(ConfigError, match="begin with a light or a twin one"):
        teach_pushes(course_from(dense), tmp_path, tmp_path, on_progress=print)


def test_a_course_teaches_something() -> None:
    played = PushRound(pushes=6, updates=0)
    PushCourse(course="pushes", rounds=(played, PushRound(pushes=6, updates=1)))
    with pytest.raises(ValidationError, match="nothing would be learnt"):
        PushCourse(course="pushes", rounds=(played,))
    with pytest.raises(ValidationError, match="no block is a ball: name some of arch, bar"):
        PushRound(pushes=6, updates=1, shapes=("bar", "ball"))
    with pytest.raises(ValidationError, match="set knots = true too"):
        PushRound(pushes=6, updates=1, hard=True)


def test_a_round_learns_from_what_is_played_by_then(
    small: None, grasps: Path, tmp_path: Path
) -> None:
    """And from enough of it: of the second round's one record none is held out."""
    played = PushRound(pushes=12, updates=0)
    with pytest.raises(ValidationError, match="round 1 learns from round 2 on"):
        PushCourse(course="pushes", rounds=(played, PushRound(pushes=6, updates=1, since=2)))
    rounds = (played, PushRound(pushes=6, updates=1, since=1))
    course = PushCourse(course="pushes", rounds=rounds, start=grasps)
    with pytest.raises(ConfigError, match="learns from records 2 to 2 of 6 pushes: too few"):
        teach_pushes(course, tmp_path, tmp_path, on_progress=print)
    assert not list(tmp_path.glob("*.npz"))


def test_a_directory_belongs_to_one_course(small: None, grasps: Path, tmp_path: Path) -> None:
    (tmp_path / "experiment.json").write_text('{"course": "other"}')
    with pytest.raises(ConfigError, match="another experiment"):
        teach_pushes(course_from(grasps), tmp_path, tmp_path, on_progress=print)


def test_one_record_of_pushes_is_too_few(grasps: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="give 201 or more"):
        teach_pushes(course_from(grasps), tmp_path, tmp_path, on_progress=print)
    assert not list(tmp_path.glob("*.npz"))
