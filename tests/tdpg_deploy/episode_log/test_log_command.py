"""tdpg-log as a user calls it."""

from __future__ import annotations

from pathlib import Path

import pytest
from synthetic_episode import Synthetic, write

from tdpg_deploy.cli.log import main


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "episode.mcap"
    synthetic = Synthetic()
    write(path, synthetic.episode(2), now=synthetic.now)
    return path


@pytest.fixture
def cut(log: Path) -> Path:
    path = log.with_name("cut.mcap.part")
    path.write_bytes(log.read_bytes()[:-5000])
    return path


def test_check_tells_the_worst(
    log: Path, cut: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty.mcap").touch()
    assert main(["check", str(log)]) == 0
    assert main(["check", str(log), str(cut)]) == 3
    assert main(["check", str(log), str(cut), str(tmp_path / "empty.mcap")]) == 1
    output = capsys.readouterr().out
    assert "episode.mcap: whole" in output
    assert "cut.mcap.part: lossy" in output
    assert "empty.mcap: nothing" in output


def test_recover_names_what_it_saved(
    cut: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["recover", str(cut)]) == 3
    saved = tmp_path / "cut.recovered.mcap"
    assert f"saved as {saved}" in capsys.readouterr().out
    assert main(["check", str(saved)]) == 0
    assert main(["recover", str(cut)]) == 1
    assert "exists already" in capsys.readouterr().err


def test_recover_to_a_chosen_place(log: Path, tmp_path: Path) -> None:
    assert main(["recover", str(log), "--out", str(tmp_path / "copy.mcap")]) == 0
    assert main(["check", str(tmp_path / "copy.mcap")]) == 0


def test_info_lists_the_steps(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(log)]) == 0
    output = capsys.readouterr().out
    assert "mock cell, policy light, seed 7" in output
    assert "ended: action limit" in output
    assert "grasp" in output
    assert "push" in output


def test_info_of_a_cut_log_shows_what_is_left(
    cut: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(cut)]) == 3
    assert "cut off" in capsys.readouterr().out


def test_info_of_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(tmp_path / "nowhere.mcap")]) == 1
    assert "tdpg-log: " in capsys.readouterr().err
