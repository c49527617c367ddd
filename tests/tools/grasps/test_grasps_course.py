"""A course of grasps on the real simulator, at the smallest size that has all of its parts."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from policies.checkpoint import PolicyConfig, load_checkpoint, save_checkpoint
from policies.networks.twin import TwinNet
from policies.policy import Choice
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.errors import ConfigError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.scenes import Scene, SceneObject
from tdpg_deploy.workspace import workspace_of
from tools.train import hold_out, teach
from tools.train.config import GraspCourse, GraspRound, Randomization
from tools.train.curve import read_curve
from tools.train.grasps import course as courses
from tools.train.grasps import play
from tools.train.grasps.course import teach_grasps
from tools.train.grasps.play import GraspRecord, GraspTask, play_grasps
from tools.train.pushes.free import look
from tools.train.trainer import training_cell


def cell(*, actions: int) -> CellConfig:
    """Where an episode has so many at most."""
    config = training_cell()
    episode = config.episode.model_copy(update={"max_actions": actions})
    return config.model_copy(update={"episode": episode})


def twin(path: Path, *, goal: bool = False) -> Path:
    """Of fresh weights."""
    torch.manual_seed(0)
    config = PolicyConfig(network="twin", width=4, goal=goal, method="tdpg-free")
    save_checkpoint(path, TwinNet(goal=goal, width=4), config, {"actions": 5})
    return path


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(courses, "RECORD", 6)
    monkeypatch.setattr(courses, "training_cell", lambda: cell(actions=2))
    monkeypatch.setattr(hold_out, "EVERY", 2)
    monkeypatch.setattr(teach, "EPOCH", 2)


def course_from(start: Path | None) -> GraspCourse:
    rounds = (GraspRound(grasps=12, updates=2), GraspRound(grasps=6, updates=2))
    return GraspCourse(course="grasps", seed=1, rounds=rounds, batch=2, start=start)


@pytest.mark.slow
def test_a_course_that_was_killed_ends_like_one_that_was_not(small: None, tmp_path: Path) -> None:
    start, told = twin(tmp_path / "twin.safetensors"), []

    def tell(*progress: object) -> None:
        told.append(progress)

    straight = tmp_path / "straight"
    path = teach_grasps(course_from(start), straight, on_progress=tell)
    assert told == [
        ("grasps tried", 6, 18),
        ("grasps tried", 12, 18),
        ("updates", 2, 4),
        ("grasps tried", 18, 18),
        ("updates", 4, 4),
    ]

    def killed(what: str, done: int, _total: int) -> None:
        if (what, done) == ("updates", 2):
            raise KeyboardInterrupt

    broken = tmp_path / "broken"
    broken.mkdir()
    for record in straight.glob("000[01].npz"):
        (broken / record.name).write_bytes(record.read_bytes())
    with pytest.raises(KeyboardInterrupt):
        teach_grasps(course_from(start), broken, on_progress=killed)
    resumed = teach_grasps(course_from(start), broken, on_progress=tell)
    assert read_curve(broken) == read_curve(straight)
    frozen, before = load_checkpoint(path), load_checkpoint(start)
    assert load_checkpoint(resumed).sha256 == frozen.sha256

    changed = {
        name for name, weight in frozen.weights.items() if not weight.equal(before.weights[name])
    }
    assert {"light.stem.weight", "light.grasp_net.weight"} < changed
    assert not any(name.startswith("push_net.") for name in changed)
    assert frozen.config == before.config
    assert frozen.provenance["start"] == {"sha256": before.sha256, "actions": 5}
    assert set(frozen.provenance["validation"]) == {"loss", "held"}


@pytest.mark.slow
def test_the_same_task_gives_the_same_record(tmp_path: Path) -> None:
    task = GraspTask(
        weights=twin(tmp_path / "twin.safetensors"),
        cell=cell(actions=2),
        randomization=Randomization(),
        seed=(3, 1),
        grasps=20,
        file=tmp_path / "one.npz",
        compact=0.5,
    )
    record = GraspRecord.load(play_grasps(task))
    again = GraspRecord.load(play_grasps(dataclasses.replace(task, file=tmp_path / "two.npz")))
    for field in dataclasses.fields(GraspRecord):
        np.testing.assert_array_equal(getattr(record, field.name), getattr(again, field.name))
    assert len(record.grasps) == len(record.held) >= 20
    assert record.grasps[:, 0].max() == len(record.heights) - 1
    before = (tmp_path / "one.npz").stat().st_mtime_ns
    play_grasps(task)  # is there already
    assert (tmp_path / "one.npz").stat().st_mtime_ns == before


@pytest.mark.slow
def test_what_is_tried_twice_meets_the_same_table() -> None:
    """A cube that stands alone: closed on, it is held, and is there again for the next grasp; one
    that closes beside it does not hold."""
    config = training_cell()
    x, y = workspace_of(config).middle
    pose = Transform(Rotation.identity(), np.array([x, y, config.workspace.table_z + 0.025]))
    cube = SceneObject(shape=SHAPES["cube"], X_base_object=pose, rgb=(200, 40, 40))
    scene = Scene(objects=(cube,))
    with open_cell(config, scene=scene, seed=1) as opened:
        heightmap, _ = look(opened)
    row, col = heightmap.workspace.to_pixel(x, y)
    on, beside = (
        Choice(kind="grasp", rotation=4, row=int(row), col=int(col) + aside, q=0.0)
        for aside in (0, 40)
    )
    doubt = play.Doubt(heightmap=heightmap, grasps=[on, beside, on], scene=scene)
    held = list(play.tried(config, doubt, np.random.default_rng(0)))
    assert [grasp for grasp, holds in held if holds] == [on, on]


def test_a_course_begins_with_a_twin_that_clears(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="give --from"):
        teach_grasps(course_from(None), tmp_path, on_progress=print)
    goal = twin(tmp_path / "goal.safetensors", goal=True)
    with pytest.raises(ConfigError, match="begin with a twin that clears tables"):
        teach_grasps(course_from(goal), tmp_path, on_progress=print)
    few = GraspRound(grasps=5, updates=1)
    course = course_from(twin(tmp_path / "twin.safetensors")).model_copy(update={"rounds": (few,)})
    with pytest.raises(ConfigError, match="too few"):
        teach_grasps(course, tmp_path, on_progress=print)
