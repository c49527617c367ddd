"""Logs as a LeRobotDataset: what a frame holds, its statistics, and that lerobot reads it.

pip install lerobot==0.4.4   (in an environment of its own: it asks for another torch)
TDPG_LEROBOT_PYTHON=thatenvironment/bin/python pytest tests/.../test_lerobot_export.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from synthetic_episode import WORKSPACE, Synthetic, write

from policies.heightmap import Heightmap
from policies.primitives import Grasp, Push
from tdpg_deploy.cli.log import main
from tdpg_deploy.episode_log.entries import Conclusion, Intent, Look
from tdpg_deploy.episode_log.lerobot import dataset, layout
from tdpg_deploy.episode_log.lerobot.frames import action_of, frames, height_picture
from tdpg_deploy.episode_log.lerobot.stats import PictureStats, of_vectors
from tdpg_deploy.episode_log.reader import read_episode

LOADER = Path(__file__).with_name("load_by_lerobot.py")
PYTHON = os.environ.get("TDPG_LEROBOT_PYTHON", sys.executable)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two episodes of two and three actions; a goal in the second."""
    folder = tmp_path_factory.mktemp("logs")
    paths = []
    for seed in (0, 1):
        synthetic = Synthetic(seed=seed)
        paths.append(folder / f"{seed}.mcap")
        calls = synthetic.episode(2 + seed, states=2, goal=seed == 1)
        write(paths[-1], calls, now=synthetic.now)
    return paths


@pytest.fixture(scope="module")
def exported(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "dataset"
    assert main(["export", "--lerobot", str(folder), *map(str, logs)]) == 0
    return folder


def told(logs: list[Path], kind: type[Any]) -> list[Any]:
    return [e for log in logs for e in read_episode(log).entries() if isinstance(e, kind)]


# --- frames -----------------------------------------------------------------------------------


def test_heights_in_millimetres_and_what_was_seen() -> None:
    height = np.zeros((224, 224), np.float32)
    height[3, 5], height[10, 20], height[30, 40] = 0.0423, np.nan, 0.9
    goal = np.zeros((224, 224), bool)
    goal[3, 5] = True
    color = np.zeros((224, 224, 3), np.uint8)
    picture = height_picture(Heightmap(workspace=WORKSPACE, color=color, height=height, goal=goal))
    assert picture[3, 5].tolist() == [42, 255, 255]
    assert picture[10, 20].tolist() == [0, 0, 0]
    assert picture[30, 40].tolist() == [255, 255, 0]
    assert picture[0, 0].tolist() == [0, 255, 0]


def test_actions_as_vectors() -> None:
    push = Push(x=0.5, y=-0.1, z=-0.12, yaw=0.3, length=0.07)
    assert action_of(push).tolist() == pytest.approx([1, 0.5, -0.1, -0.12, 0.3, 0.07])
    grasp = Grasp(x=0.5, y=-0.1, z=-0.12, yaw=0.3)
    assert action_of(grasp).tolist() == pytest.approx([0, 0.5, -0.1, -0.12, 0.3, 0])


def test_a_frame_is_what_was_seen_before_the_action(logs: list[Path]) -> None:
    looks = told(logs[:1], Look)
    made = list(frames(read_episode(logs[0])))
    assert [frame.task for frame in made] == ["clear the table"] * 2
    for frame, look in zip(made, looks, strict=False):  # one more after the last action
        np.testing.assert_array_equal(frame.camera, look.frame.color)
        np.testing.assert_array_equal(frame.map_color, look.heightmap.color)
    assert [frame.success for frame in made] == [True, False]


def test_an_action_of_no_numbers_is_left_out(tmp_path: Path) -> None:
    synthetic = Synthetic()
    calls = synthetic.episode(2, states=1)
    at = next(i for i, call in enumerate(calls) if call.name == "arm_state")
    [state] = calls[at].arguments
    calls[at] = replace(calls[at], arguments=(replace(state, q=np.full(6, 1e300)),))
    write(tmp_path / "log.mcap", calls, now=synthetic.now)
    assert len(list(frames(read_episode(tmp_path / "log.mcap")))) == 1


# --- statistics -------------------------------------------------------------------------------


def test_statistics_of_vectors() -> None:
    values = np.random.default_rng(0).normal(size=(40, 6))
    stats = of_vectors(values.tolist())
    np.testing.assert_allclose(stats["mean"], values.mean(axis=0))
    np.testing.assert_allclose(stats["q90"], np.quantile(values, 0.9, axis=0))
    assert stats["count"] == [40]
    assert of_vectors([True, False, True, True])["mean"] == [0.75]


def test_statistics_of_pictures_are_those_of_all_pixels() -> None:
    rng = np.random.default_rng(0)
    pictures = rng.integers(20, 200, (5, 9, 7, 3), np.uint8)
    counted = PictureStats()
    for picture in pictures:
        counted.add(picture)
    stats = counted.stats()
    pixels = pictures.reshape(-1, 3) / 255
    for name, expected in {
        "min": pixels.min(axis=0), "max": pixels.max(axis=0), "mean": pixels.mean(axis=0),
        "std": pixels.std(axis=0), "q50": np.quantile(pixels, 0.5, axis=0, method="inverted_cdf"),
    }.items():  # fmt: skip
        np.testing.assert_allclose(np.ravel(stats[name]), expected, atol=1e-12)
    assert np.shape(stats["mean"]) == (3, 1, 1)
    assert stats["count"] == [5]


# --- files ------------------------------------------------------------------------------------


def test_the_files_hold_what_was_logged(logs: list[Path], exported: Path) -> None:
    table = pq.read_table(exported / layout.DATA_PATH.format(chunk_index=0, file_index=0))
    assert table["episode_index"].to_pylist() == [0, 0, 1, 1, 1]
    assert table["frame_index"].to_pylist() == [0, 1, 0, 1, 2]
    assert table[layout.DONE].to_pylist() == [False, True, False, False, True]
    actions = [action_of(intent.decision.primitive).tolist() for intent in told(logs, Intent)]
    assert table[layout.ACTION].to_pylist() == actions
    success = [entry.outcome.success.value == "yes" for entry in told(logs, Conclusion)]
    assert table[layout.SUCCESS].to_pylist() == success
    png = np.frombuffer(table[layout.CAMERA][0].as_py()["bytes"], np.uint8)
    picture = cv2.imdecode(png, cv2.IMREAD_COLOR)
    assert picture is not None
    np.testing.assert_array_equal(picture[..., ::-1], told(logs, Look)[0].frame.color)
    info = json.loads((exported / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (2, 5, 2)
    assert info["features"].keys() == set(table.column_names)


def test_episodes_lie_whole_in_their_files(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layout, "FILE_SIZE", 1)
    monkeypatch.setattr(dataset, "BATCH", 2)
    main(["export", "--lerobot", str(tmp_path / "dataset"), *map(str, logs)])
    episodes = pq.read_table(tmp_path / "dataset" / layout.EPISODES_PATH).to_pylist()
    assert [episode["data/file_index"] for episode in episodes] == [0, 1]
    assert [episode["length"] for episode in episodes] == [2, 3]
    for one, other in pairwise(episodes):
        assert one["dataset_to_index"] == other["dataset_from_index"]


def test_a_damaged_log_gives_what_can_be_read(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap.part"
    cut.write_bytes(logs[1].read_bytes()[: int(0.8 * logs[1].stat().st_size)])
    assert main(["export", "--lerobot", str(tmp_path / "dataset"), str(cut)]) == 3
    assert "damaged at byte" in capsys.readouterr().out
    episodes = pq.read_table(tmp_path / "dataset" / layout.EPISODES_PATH).to_pylist()
    assert [episode["length"] for episode in episodes] == [2]


def test_nothing_to_export_and_nothing_overwritten(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "dataset"
    other = tmp_path / "other.mcap"
    other.write_bytes(b"not a log")
    assert main(["export", "--lerobot", str(target), str(other)]) == 1
    assert not target.exists()
    target.mkdir()
    assert main(["export", "--lerobot", str(target), str(logs[0])]) == 1
    assert "no new folder" in capsys.readouterr().err


# --- by lerobot itself ------------------------------------------------------------------------


@pytest.mark.slow
def test_lerobot_loads_it(logs: list[Path], exported: Path, tmp_path: Path) -> None:
    there = subprocess.run([PYTHON, "-c", "import lerobot"], capture_output=True, check=False)
    if there.returncode != 0:
        pytest.skip("lerobot is not installed: see the head of this file")
    run = subprocess.run(
        [PYTHON, str(LOADER), str(exported)], capture_output=True, text=True, timeout=300,
        check=True, env=os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)},
    )  # fmt: skip
    found = json.loads(run.stdout.splitlines()[-1])
    assert (found["frames"], found["episodes"], found["fps"]) == (5, 2, 1)
    assert found["episode_index"] == [0, 0, 1, 1, 1]
    assert found["timestamp"] == [0.0, 1.0, 0.0, 1.0, 2.0]
    assert found["task"] == ["clear the table"] * 2 + ["fetch the marked object"] * 3
    assert found["done"] == [False, True, False, False, True]
    assert found["last episode"] == 3
    assert found["pictures"][layout.CAMERA] == [48, 64, 3]
    assert found["tensors"] == {
        layout.CAMERA: [3, 48, 64],
        layout.MAP_COLOR: [3, 224, 224],
        layout.MAP_HEIGHT: [3, 224, 224],
    }
    actions = [action_of(intent.decision.primitive).tolist() for intent in told(logs, Intent)]
    assert found["action"] == actions
    assert found["next actions"] == actions[:2]
    rewards = [float(entry.outcome.success.value == "yes") for entry in told(logs, Conclusion)]
    assert found["reward"] == rewards
    np.testing.assert_allclose(found["stats"]["mean"], np.mean(actions, axis=0), rtol=1e-6)
    for name, means in found["means"].items():  # of the pictures, as lerobot hands them out
        assert np.mean(found["picture stats"][name]) == pytest.approx(np.mean(means), abs=1e-5)
    camera = told(logs, Look)[0].frame.color
    assert found["means"][layout.CAMERA][0] == pytest.approx(camera.mean() / 255, abs=1e-5)
