"""Every command, on logs that mean harm: an exit code and a message, never a traceback.

TDPG_FUZZ=2000 pytest tests/tools/test_hostile_logs.py   tries that many.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from poisoned_log import HOSTILE, poison_file
from synthetic_episode import ABOUT, Synthetic, write_about

from tdpg_deploy.cli import log as log_cli
from tdpg_deploy.sim.scene_file import format_scene
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.workspace import workspace_of
from tools.audit import cli as audit_cli
from tools.evaluate import cli as evaluate_cli
from tools.replay import cli as replay_cli

LOGS = int(os.environ.get("TDPG_FUZZ", "24"))
BATCHES = 4


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "episode.mcap"
    scene = random_scene(3, workspace_of(ABOUT.cell), np.random.default_rng(0))
    about = ABOUT.__class__(**{**vars(ABOUT), "scene": format_scene(scene)})
    synthetic = Synthetic()
    write_about(path, synthetic.episode(2, states=3), about, now=synthetic.now)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("batch", range(BATCHES))
def test_no_command_is_hurt(
    whole: Path, tmp_path: Path, batch: int, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(batch, LOGS, BATCHES):
        folder = tmp_path / str(number)
        log = folder / "logs" / HOSTILE.replace("/", "_") / f"{number}.mcap"
        log.parent.mkdir(parents=True)
        poison_file(whole, log, np.random.default_rng(number))
        run_every_command(log, folder)
        out, err = capsys.readouterr()
        assert len((out + err).encode()) < 1_000_000
        assert not {"\x1b", "\x00", "\u202e"} & set(out + err)
        assert {path.name for path in folder.iterdir()} <= {"logs", "site", "eval", "saved.mcap"}
        for page in (folder / "site").rglob("*.html"):
            text = page.read_text(encoding="utf-8")
            assert text.count("<script") == 2
            assert "owned'</script>" not in text
    assert {path.name for path in tmp_path.iterdir()} <= set(map(str, range(LOGS)))


def run_every_command(log: Path, folder: Path) -> None:
    path, logs = str(log), str(folder / "logs")
    whole = log_cli.main(["check", path])
    assert whole in (0, 1, 3)
    assert log_cli.main(["info", path]) in (0, 1, 3)
    assert log_cli.main(["recover", path, "-o", str(folder / "saved.mcap")]) in (0, 1, 3)
    audited = audit_cli.main([logs, "--workers", "1", "--html", str(folder / "site")])
    assert audited in (0, 3)
    assert replay_cli.main([path]) in (0, 2, 3)
    assert replay_cli.main([path, "--policy", "random"]) in (0, 1, 2, 3)
    assert evaluate_cli.main(["--logs", path, "--out", str(folder / "eval")]) in (0, 2)
