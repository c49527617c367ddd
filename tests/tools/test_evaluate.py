"""tdpg-eval on the real simulator, at its smallest."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.errors import LogError
from tools.evaluate.cli import main
from tools.evaluate.rows import read_row


@pytest.mark.slow
def test_an_evaluation_goes_on_where_it_was_interrupted(tmp_path: Path) -> None:
    command = ["--policy", "random", "--objects", "1", "--episodes", "2", "--workers", "1"]
    command += ["--seed", "7", "--out", str(tmp_path)]
    assert main(command) == 0
    logs = sorted(tmp_path.rglob("*.mcap"))
    assert [log.name for log in logs] == ["random-1-7.mcap", "random-1-8.mcap"]
    (report,) = json.loads((tmp_path / "figures.json").read_text())
    assert report["metrics"]["of_all"]["episodes"] == 2
    for log, row in zip(logs, report["episodes"], strict=True):
        result = read_episode(log).result()
        assert result is not None
        assert row["reason"] == result.reason.value
        assert row["objects"] == 1
        assert row["actions"] == result.actions == len(row["lifted"])
        assert sum(row["lifted"]) == result.grasp_successes

    judged = tmp_path / "judged"
    assert main(["--logs", *map(str, logs), "--out", str(judged)]) == 0
    (again,) = json.loads((judged / "figures.json").read_text())
    assert (again["tables"], again["policy"]) == ("mock", "random")
    assert again["metrics"] == report["metrics"]

    written = [log.stat().st_mtime_ns for log in logs]
    assert main(command) == 0
    assert [log.stat().st_mtime_ns for log in logs] == written


def test_a_log_that_is_none(tmp_path: Path) -> None:
    file = tmp_path / "noise.mcap"
    file.write_bytes(b"noise")
    with pytest.raises(LogError, match=r"noise\.mcap"):
        read_row(file, scene="random 1")
