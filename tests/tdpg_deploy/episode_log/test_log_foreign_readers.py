"""Whole and recovered logs, as programs of others read them; each test needs its program.

pip install rerun-sdk pymcap-cli          (found on the PATH)
npm install @mcap/core @mcap/support      (TDPG_NODE_MODULES names the node_modules folder)
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from synthetic_episode import Synthetic, write

from tdpg_deploy.episode_log.recover import Condition, recover

NODE_MODULES = os.environ.get("TDPG_NODE_MODULES", "")
COUNT = Path(__file__).with_name("count_messages.mjs")


@pytest.fixture(scope="module", params=["whole", "recovered"])
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("log")
    path = folder / "whole.mcap"
    synthetic = Synthetic()
    write(path, synthetic.episode(2, states=3), now=synthetic.now)
    if request.param == "whole":
        return path
    cut = folder / "cut.mcap.part"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    assert recover(cut, folder / "recovered.mcap").condition is Condition.LOSSY
    return folder / "recovered.mcap"


def run(*command: str | Path) -> str:
    if shutil.which(str(command[0])) is None:
        pytest.skip(f"{command[0]} is not installed: see the head of this file")
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.slow
def test_rerun_checks_it(log: Path) -> None:
    run("rerun", "mcap", "check", log)


@pytest.mark.slow
def test_pymcap_finds_no_fault(log: Path) -> None:
    run("pymcap-cli", "doctor", log)


@pytest.mark.slow
@pytest.mark.skipif(not NODE_MODULES, reason="TDPG_NODE_MODULES is not set")
def test_the_javascript_reader_finds_every_message(log: Path) -> None:
    recovered = recover(log, log.with_name(f"{log.stem}.again.mcap"))  # counts them
    told = run("node", COUNT, NODE_MODULES, log).split()
    assert told == [str(recovered.messages)] * 3
