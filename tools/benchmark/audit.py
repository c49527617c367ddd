"""tdpg-audit on two hundred episodes of thirty steps: the command itself, in its own processes.

Two simulated episodes stand for them under a hundred names each, so that they come from the page
cache and not from a disk.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from tdpg_deploy.episode_log.reader import read_episode
from tools.benchmark.logged_episodes import replicate, simulate
from tools.benchmark.measure import Measurement
from tools.pool import process_pool

DIFFERENT, EPISODES, FEWER, STEPS = 2, 200, 20, 30


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Of a command with all its processes. memory: of the largest of them, in bytes."""

    wall: float
    cpu: float
    memory: float


def run() -> list[Measurement]:
    with TemporaryDirectory(prefix="tdpg-bench-") as name:
        folder = Path(name)
        # In a process of its own: a child's peak of memory is no lower than its parent's was.
        with process_pool(1) as worker:
            simulated = partial(simulate, folder / "simulated", episodes=DIFFERENT, actions=STEPS)
            logs = worker.submit(simulated).result()
        replicate(logs, folder / "many", episodes=EPISODES)
        replicate(logs, folder / "few", episodes=FEWER)
        steps = [sum(1 for _ in read_episode(log).steps(images=False)) for log in logs]
        total = sum(steps) * EPISODES // DIFFERENT
        few = _audit(folder / "few", "--out", str(folder / "few tables"))
        many = _audit(folder / "many", "--out", str(folder / "tables"))
        pages = _audit(folder / "many", "--html", str(folder / "pages"))
    what = f"{EPISODES} logs, {total} steps"
    return [
        _one(f"audit of {what}", "steps/s", total / many.wall),
        _one("audit, of a CPU's second", "steps/s", total / many.cpu),
        _one("audit, largest process", "MB", many.memory / 1e6, few.memory / 1e6),
        _one(f"audit and pages of {what}", "s", pages.wall),
        _one("audit and pages, CPU", "s", pages.cpu),
        _one("audit and pages, largest process", "MB", pages.memory / 1e6),
    ]


def _audit(*arguments: str | Path) -> Cost:
    command = [sys.executable, "-m", "tools.audit.cli", *map(str, arguments)]
    start = time.perf_counter()
    silence = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    child = os.posix_spawn(sys.executable, command, os.environ, file_actions=silence)
    _, status, usage = os.wait4(child, 0)
    wall = time.perf_counter() - start
    if status != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {os.waitstatus_to_exitcode(status)}")
    return Cost(wall=wall, cpu=usage.ru_utime + usage.ru_stime, memory=1024 * usage.ru_maxrss)


def _one(name: str, unit: str, value: float, reference: float | None = None) -> Measurement:
    return Measurement(
        name=name, unit=unit, median=value, low=value, high=value, repeats=1, reference=reference
    )
