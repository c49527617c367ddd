"""tdpg-run as a user meets it: what it says, what it leaves, how it exits."""

from __future__ import annotations

import io
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tdpg_deploy.cell_config import DEFAULT_CELL
from tdpg_deploy.cli.run import main
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.outcome import EndReason

SCENE_HEAD = 'version = 1\nframe = "base"\nlength = "m"\nquaternion = "xyzw"\n'
CUBE = """
[[object]]
shape = "cube"
position = [0.5, 0.0, -0.125]
quaternion = [0.0, 0.0, 0.0, 1.0]
rgb = [225, 87, 89]
"""


def run(capsys: pytest.CaptureFixture[str], *args: str | Path) -> tuple[int, str]:
    """Exit code, and what was printed with its line breaks folded."""
    code = main(["--policy", "random", *map(str, args)])
    return code, re.sub(r"\s+", " ", capsys.readouterr().out)


def scene(directory: Path, text: str) -> Path:
    file = directory / "scene.toml"
    file.write_text(SCENE_HEAD + text)
    return file


def test_an_empty_table_is_cleared_without_a_motion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = run(capsys, "--scene", scene(tmp_path, ""), "--out", tmp_path)
    assert code == 0
    assert "cleared" in said
    (log,) = tmp_path.glob("*.mcap")
    result = read_episode(log).result()
    assert result is not None
    assert (result.reason, result.actions) == (EndReason.CLEARED, 0)
    assert log.with_suffix(".png").stat().st_size > 1000


@pytest.mark.slow
def test_a_cube_is_cleared_and_the_log_says_how(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = run(capsys, "--scene", scene(tmp_path, CUBE), "--out", tmp_path, "--seed", "2")
    assert code == 0
    assert "1 of 1" in said
    (log,) = tmp_path.glob("*.mcap")
    episode = read_episode(log)
    assert episode.about.seed == 2
    assert episode.about.scene is not None
    result = episode.result()
    assert result is not None
    assert result.truth == {"workspace": 0, "bin": 1, "outside": 0}


def test_a_missing_checkpoint(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["--policy", str(tmp_path / "absent.pt")]) == 2
    assert "cannot be read" in capsys.readouterr().out


def test_a_foreign_checkpoint(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    foreign = tmp_path / "vpg.pth"
    foreign.write_bytes(b"\x80\x02}q\x00.")
    assert main(["--policy", str(foreign)]) == 2
    assert "pickle" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (CUBE.replace("cube", "duck"), 'object[0].shape = "duck" is not one of arch'),
        (CUBE.replace("0.5,", "nan,"), "object[0].position[0] = nan"),
        (CUBE.replace("0.5,", "0.9,"), "lies outside of the workspace"),
    ],
)
def test_a_wrong_scene_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, expected: str
) -> None:
    code, said = run(capsys, "--scene", scene(tmp_path, text), "--out", tmp_path)
    assert code == 2
    assert expected in said
    assert not list(tmp_path.glob("*.mcap*"))


def test_a_wrong_cell_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text(DEFAULT_CELL.read_text() + 'speed = "3 furlongs"\n')
    code, said = run(capsys, "--config", cell, "--out", tmp_path)
    assert code == 2
    assert "limits.speed: unknown key" in said


def test_a_goal_has_to_be_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = run(capsys, "--goal", "--scene", scene(tmp_path, CUBE), "--out", tmp_path)
    assert code == 2
    assert "goal = true" in said


@pytest.mark.parametrize("objects", ["0", "31", "many"])
def test_objects_are_one_to_thirty(objects: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit:
        main(["--objects", objects])
    assert exit.value.code == 2
    assert "--objects" in capsys.readouterr().err


def test_a_directory_that_cannot_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "logs").write_text("a file where the directory should be")
    code, said = run(capsys, "--scene", scene(tmp_path, ""), "--out", tmp_path / "logs")
    assert code == 4
    assert "cannot be created" in said


def test_real_asks_and_nobody_can_answer(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    code, said = run(capsys, "--real")
    assert code == 2
    assert "nobody can answer" in said
    assert "0.12 m/s" in said  # a quarter of the cell's 0.5 m/s


def test_real_without_a_robot_fails_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing listens on this loopback address."""
    cell = tmp_path / "cell.toml"
    text = DEFAULT_CELL.read_text().replace("[arm]", '[arm]\nhost = "127.77.77.77"')
    cell.write_text(text)
    started = time.monotonic()
    code, said = run(capsys, "--real", "--unattended", "--config", cell, "--out", tmp_path)
    assert code == 3
    assert "127.77.77.77" in said
    assert time.monotonic() - started < 10  # of which importing the driver takes some


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_stops_the_arm_and_closes_the_log(tmp_path: Path, sent: signal.Signals) -> None:
    """Even in a process that was started with SIGINT ignored, as shells do in the background."""
    command = 'trap \'\' INT; exec "$0" -m tdpg_deploy.cli.run --policy random --out "$1"'
    process = subprocess.Popen(
        ["bash", "-c", command, sys.executable, tmp_path], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    for line in process.stdout:  # ends with the process
        if "grasp at" in line:
            break
    process.send_signal(sent)
    assert process.wait(timeout=60) == 130
    (log,) = tmp_path.glob("*.mcap")
    result = read_episode(log).result()
    assert result is not None
    assert result.reason is EndReason.OPERATOR_STOP
    assert result.seconds > 0
