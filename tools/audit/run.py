"""Many logs -> their rows, in parallel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tdpg_deploy.errors import ConfigError, LogError, SceneError
from tools.audit.engines import Engine, in_parallel
from tools.audit.rows import AuditedLog, audit_log

PATTERNS = ("*.mcap", "*.mcap.part")  # a .part is what a killed process left


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
    folder: Path, logs: Sequence[Path], *, workers: int, engine: Engine
) -> Iterator[AuditedLog | Unreadable]:
    """In the order of `logs`."""
    tasks = ((path, name_of(path, folder)) for path in logs)
    return in_parallel(_audit, tasks, workers=workers, engine=engine)


def _audit(task: tuple[Path, str]) -> AuditedLog | Unreadable:
    path, name = task
    try:
        return audit_log(path, name=name)
    except LogError as error:  # names the file
        return Unreadable(path=path, why=str(error))
    except SceneError as error:
        return Unreadable(path=path, why=f"{path}: its scene: {error}")
