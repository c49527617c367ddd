"""Many logs -> their rows, in parallel processes. Memory does not grow with the set."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from tdpg_deploy.errors import ConfigError, LogError, SceneError
from tools.audit.rows import AuditedLog, audit_log

AHEAD = 4  # logs in the works for each process
PATTERNS = ("*.mcap", "*.mcap.part")  # a .part is what a killed process left

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class Unreadable:
    """A file that is not an episode's log, and why."""

    path: Path
    why: str


def find_logs(folder: Path) -> list[Path]:
    """All logs below the folder, by name. Raises ConfigError if there are none."""
    if not folder.is_dir():
        raise ConfigError(f"{folder}: there is no such folder")
    logs = sorted(path for pattern in PATTERNS for path in folder.rglob(pattern))
    if not logs:
        raise ConfigError(f"{folder}: no logs (*.mcap) in it or below")
    return logs


def name_of(path: Path, folder: Path) -> str:
    """How tables and pages call a log: its path below the folder, without its ending."""
    name = path.relative_to(folder).as_posix()
    return name.removesuffix(".part").removesuffix(".mcap")


def audit_logs(
    folder: Path, logs: Sequence[Path], *, workers: int
) -> Iterator[AuditedLog | Unreadable]:
    """In the order of `logs`."""
    tasks = ((path, name_of(path, folder)) for path in logs)
    return in_parallel(_audit, tasks, workers=workers)


def _audit(task: tuple[Path, str]) -> AuditedLog | Unreadable:
    path, name = task
    try:
        return audit_log(path, name=name)
    except LogError as error:  # names the file
        return Unreadable(path=path, why=str(error))
    except SceneError as error:
        return Unreadable(path=path, why=f"{path}: its scene: {error}")


def in_parallel(work: Callable[[T], R], tasks: Iterator[T], *, workers: int) -> Iterator[R]:
    """`work` on every task, in order; at most AHEAD * workers are in the works or wait."""
    if workers == 1:
        yield from map(work, tasks)
        return
    waiting: deque[Future[R]] = deque()
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for task in tasks:
            waiting.append(pool.submit(work, task))
            if len(waiting) >= AHEAD * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
