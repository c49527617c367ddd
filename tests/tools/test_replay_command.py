"""tdpg-replay as a user meets it."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from kinematic_log import write_log

from policies.baselines import RandomPolicy
from policies.errors import HeightmapError
from policies.shipped import NamedPolicy
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.geometry import Transform
from tdpg_deploy.outcome import PushOutcome
from tdpg_deploy.plan import MoveLinear
from tdpg_deploy.session import log_episode
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.workspace import workspace_of
from tools.audit.causes import WHAT_TO_CHANGE, Cause, Finding
from tools.replay.cli import main
from tools.replay.messages_of import channels_of, raw_messages, start_of
from tools.replay.reenact import TableFrom, reenact
from tools.replay.telling import tell_tried

POLICY = NamedPolicy(name="random", decider=RandomPolicy(), sha256=None)


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> Episode:
    return write_log(tmp_path_factory.mktemp("logs") / "a.mcap", POLICY, actions=3)


@pytest.fixture
def log(episode: Episode) -> str:
    return str(episode.path)


def run(capsys: pytest.CaptureFixture[str], *args: str | Path) -> tuple[int, str]:
    """Exit code, and what was printed with its line breaks folded."""
    code = main([str(arg) for arg in args])
    return code, re.sub(r"\s+", " ", capsys.readouterr().out)


# --- in the terminal --------------------------------------------------------------------------


def test_every_step_is_told(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = run(capsys, log)
    assert code == 0
    assert "policy random, seed 3, commit 0123456789abcdef" in said
    assert [f"step {n}" in said for n in (1, 2, 3, 4)] == [True, True, True, False]
    for told in ("seen", "decided grasp at (", "measured", "outcome"):
        assert told in said


def test_it_begins_where_it_is_told(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    _, said = run(capsys, log, "--from", "3")
    assert "step 3" in said
    assert "step 2" not in said
    _, said = run(capsys, log, "--from", "9")
    assert "the log has 3 steps" in said
    _, said = run(capsys, log, "--from", "4")
    assert "the log has 3 steps" in said


def test_a_failed_step_says_what_to_change(
    log: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    missed = Finding(cause=Cause.MISSED_GRASP, evidence="0 mm")
    monkeypatch.setattr("tools.replay.telling.explain_action", lambda *_: (missed,))
    _, said = run(capsys, log)
    assert said.count(f"why missed grasp: 0 mm change {WHAT_TO_CHANGE[missed.cause][:20]}") == 3


@pytest.mark.parametrize("option", [["--from", "x"], ["--from", "0"], ["--speed", "fast"]])
def test_a_wrong_number(log: str, capsys: pytest.CaptureFixture[str], option: list[str]) -> None:
    with pytest.raises(SystemExit) as exit:
        main([log, *option])
    assert exit.value.code == 2
    assert f"{option[1]} is not a" in capsys.readouterr().err


def test_step_by_step_past_the_end_and_without_an_answer(
    log: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter(["99"])
    monkeypatch.setattr("builtins.input", lambda *_: next_or_end(answers))
    code, said = run(capsys, log, "--step")
    assert code == 0
    assert re.findall(r"step \d|has \d steps", said) == ["step 1", "has 3 steps", "step 3"]


def next_or_end(answers: Iterator[str]) -> str:
    for answer in answers:
        return answer
    raise EOFError


def test_step_by_step_with_a_jump(
    log: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter(["3", "2", "", "q"])
    monkeypatch.setattr("builtins.input", lambda *_: next(answers))
    _, said = run(capsys, log, "--step")
    assert re.findall(r"step \d", said) == ["step 1", "step 3", "step 2", "step 3"]


def test_two_logs_side_by_side(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    shorter = write_log(tmp_path / "b.mcap", POLICY, actions=1, seed=4)
    code, said = run(capsys, log, "--against", shorter.path)
    assert code == 0
    assert "seed 3" in said
    assert "seed 4" in said
    assert said.count("no such step") == 2


def test_a_cut_log_is_played_to_its_end(
    episode: Episode, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    data = episode.path.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    code, said = run(capsys, cut)
    assert code == 3
    assert "step 1" in said
    assert "damaged at byte" in said


# --- decided again ----------------------------------------------------------------------------


def test_the_same_policy_decides_the_same(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = run(capsys, log, "--policy", "random")
    assert code == 0
    assert "3 of 3 steps are the same, bit for bit" in said


def test_a_moved_camera_is_the_cause(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = run(capsys, log, "--move-camera", "5 mm,0,0")
    assert code == 0  # a question, not a test
    assert "Cause: calibration" in said
    assert "X_base_camera is 5.00 mm and 0.000 deg from the logged one" in said


def test_another_cell_file_is_the_cause(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text(DEFAULT_CELL.read_text().replace("[arm]", '[arm]\nhost = "10.0.0.9"'))
    _, said = run(capsys, log, "--config", cell)
    assert "calibration" in said  # the fake camera hangs elsewhere than the mock cell's


def test_a_policy_that_is_not_here_has_to_be_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = NamedPolicy(name="lost.safetensors", decider=RandomPolicy(), sha256="ab" * 32)
    episode = write_log(tmp_path / "lost.mcap", lost, actions=1)
    code, said = run(capsys, episode.path, "--move-camera", "0,0,0")
    assert code == 2
    assert "name its file with --policy" in said


@pytest.mark.parametrize("offset", ["5", "a,b,c"])
def test_a_wrong_offset(log: str, capsys: pytest.CaptureFixture[str], offset: str) -> None:
    code, said = run(capsys, log, "--move-camera", offset)
    assert code == 2
    assert "three lengths" in said


def test_a_policy_for_another_task(
    log: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Fetching:
        def decide(self, *_: object, **__: object) -> None:
            raise HeightmapError("this policy fetches a goal")

    fetching = NamedPolicy(name="fetch", decider=Fetching(), sha256=None)  # type: ignore[arg-type]
    monkeypatch.setattr("tools.replay.command.open_policy", lambda _: fetching)
    code, said = run(capsys, log, "--policy", "fetch")
    assert code == 2
    assert "fetch cannot decide on this log, which may be of another task: this policy" in said


def test_a_file_that_is_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = run(capsys, tmp_path / "absent.mcap")
    assert code == 2
    assert "cannot be read" in said


# --- tried again ------------------------------------------------------------------------------


def test_a_table_without_a_scene_is_fitted_with_boxes(episode: Episode) -> None:
    """Three boxes stand on the kinematic table; the physics takes the first as it was taken."""
    tried = reenact(episode, 1)
    assert tried.table is TableFrom.HEIGHTMAP
    assert tried.objects == 3
    assert tried.likeness > 0.97
    assert tried.error is None
    assert tried.outcome is not None
    assert not isinstance(tried.outcome, PushOutcome)


@pytest.mark.slow
def test_a_simulated_episode_leads_to_the_same_table_bit_for_bit(tmp_path: Path) -> None:
    config = load_cell(DEFAULT_CELL)
    simulation = config.simulation.model_copy(update={"carrier": "gantry"})
    limits = config.episode.model_copy(update={"max_actions": 2})
    config = config.model_copy(update={"simulation": simulation, "episode": limits})
    scene = random_scene(3, workspace_of(config), np.random.default_rng(5))
    log_episode(config, POLICY, tmp_path / "sim.mcap", seed=5, scene=scene)
    tried = reenact(read_episode(tmp_path / "sim.mcap"), 2)
    assert tried.table is TableFrom.SCENE
    assert tried.likeness == 1.0
    assert tried.same
    told = dict(tell_tried(tried, logged_by="a", commit="b"))
    assert "differs" not in told
    otherwise = dict(tell_tried(replace(tried, logged=None), logged_by="a", commit="b"))
    assert "commit b, in the log a" in otherwise["differs"]


@pytest.mark.parametrize("lift", [False, True])
def test_a_logged_plan_that_nobody_would_run(
    episode: Episode, monkeypatch: pytest.MonkeyPatch, lift: bool
) -> None:
    """Without its lift, or through the table: a log may hold anything."""
    steps = list(episode.steps())
    intent = steps[0].intent
    assert intent is not None
    approach = list(intent.plan.approach[:-1])
    if lift:
        last = intent.plan.approach[-1]
        assert isinstance(last, MoveLinear)
        below = Transform(last.X_base_tool.rotation, last.X_base_tool.translation - [0, 0, 1])
        approach.append(replace(last, X_base_tool=below))
    plan = replace(intent.plan, approach=tuple(approach))
    altered = [replace(steps[0], intent=replace(intent, plan=plan))]
    monkeypatch.setattr(Episode, "steps", lambda *_, **__: iter(altered))
    tried = reenact(episode, 1)
    assert tried.outcome is None
    assert tried.error is not None
    assert tried.error.startswith("PlanRefused: ")


def test_a_step_that_is_not_there(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = run(capsys, log, "--reenact", "--from", "9")
    assert code == 2
    assert "no step 9" in said


@pytest.mark.parametrize(
    "options", [["--reenact", "--policy", "random"], ["--rerun", "--foxglove"]]
)
def test_what_does_not_go_together(
    log: str, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    with pytest.raises(SystemExit) as exit:
        main([log, *options])
    assert exit.value.code == 2
    assert "not allowed with" in capsys.readouterr().err


# --- pictures and viewers ---------------------------------------------------------------------


def test_a_video_has_as_many_pictures_as_it_says(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "out.mp4"
    code, said = run(capsys, log, "--video", path, "--from", "3", "--speed", "20")
    assert code == 0
    video = cv2.VideoCapture(str(path))
    read, picture = video.read()
    assert read
    assert picture.shape == (720, 1280, 3)
    assert f"{int(video.get(cv2.CAP_PROP_FRAME_COUNT))} pictures" in said
    seen = picture[60:370, 30:590].astype(int)
    assert np.abs(seen - 128).mean() < 6  # the fake camera's picture is grey
    assert list(tmp_path.iterdir()) == [path]


def test_other_videos_are_not_written(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = run(capsys, log, "--video", tmp_path / "out.gif")
    assert code == 2
    assert "only .mp4 is written" in said


@pytest.mark.parametrize(("option", "package"), [("--foxglove", "foxglove"), ("--rerun", "rerun")])
def test_a_viewer_that_is_not_installed(
    log: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    option: str,
    package: str,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    code, said = run(capsys, log, option)
    assert code == 2
    assert "pip install 'tdpg-deploy[view]'" in said


def test_raw_messages_are_all_there_and_channels_are_known_ahead(episode: Episode) -> None:
    messages = list(raw_messages(episode))
    topics = {message.topic for message in messages}
    assert topics <= channels_of(episode).keys()
    looks = [message.log_time for message in messages if message.topic == "/look"]
    assert start_of(episode, 1) == looks[0]
    assert start_of(episode, 3) == looks[2]
