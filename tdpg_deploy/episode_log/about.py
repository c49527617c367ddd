"""What stands at the head of every log: how the episode came to be."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from tdpg_deploy.cell_config import CellConfig, parse_cell
from tdpg_deploy.episode_log.documents import text
from tdpg_deploy.errors import ConfigError, LogError

SCHEMA_VERSION = 1  # of channels and documents; docs/log.md says what changed when

MAX_FILE = 100_000  # bytes of a cell or scene file; ours have at most 8,000
LATEST = 253_402_300_799  # s since the UNIX epoch: the end of the year 9999, and of calendars

N = TypeVar("N", int, float)

METADATA = "tdpg"
VERSIONS = "versions"
RESULT = "result"
CELL = "cell.json"
SCENE = "scene"
LAYOUT = "foxglove-layout.json"


@dataclass(frozen=True, kw_only=True)
class About:
    """How an episode came to be.

    policy: name of the method or of the checkpoint's file. checkpoint_sha256: None for policies
    without weights. started_at: seconds since the UNIX epoch. scene: the scene file's text, if
    objects were placed by one. versions: of what was installed; commit: of the source, if known.
    """

    cell: CellConfig
    policy: str
    started_at: float
    checkpoint_sha256: str | None = None
    seed: int | None = None
    command: str = ""
    scene: str | None = None
    commit: str | None = None
    versions: Mapping[str, str] = field(default_factory=dict)


def to_metadata(about: About, clock_offset: int) -> dict[str, str]:
    """As MCAP metadata. clock_offset: nanoseconds from the cell's clock to the UNIX epoch."""
    known = {
        "schema_version": SCHEMA_VERSION,
        "policy": about.policy,
        "started_at": about.started_at,
        "clock_offset_ns": clock_offset,
        "checkpoint_sha256": about.checkpoint_sha256,
        "seed": about.seed,
        "command": about.command,
        "commit": about.commit,
    }
    return {key: str(value) for key, value in known.items() if value is not None}


def cell_attachment(cell: CellConfig) -> bytes:
    return cell.model_dump_json(indent=2).encode()


def check_version(metadata: Mapping[str, str]) -> None:
    """Raises LogError for a log that this version cannot read."""
    version = metadata.get("schema_version", "")
    if not version.isdecimal():
        raise LogError("a tdpg log without a schema version")
    if int(version) > SCHEMA_VERSION:
        raise LogError(
            f"log schema {version} is newer than {SCHEMA_VERSION}, which this version reads: "
            "update tdpg-deploy"
        )


def from_metadata(
    metadata: Mapping[str, str],
    versions: Mapping[str, str],
    attachments: Mapping[str, bytes],
) -> About:
    """Raises LogError."""
    try:
        metadata = {key: text(value) for key, value in metadata.items()}
        check_version(metadata)
        for name in (CELL, SCENE):
            size = len(attachments.get(name, b""))
            if size > MAX_FILE:
                raise ValueError(f"{name} of {size} bytes; at most {MAX_FILE} are read")
        scene = attachments.get(SCENE)
        seed = metadata.get("seed")
        cell = parse_cell(json.loads(attachments[CELL]), source=CELL)
        return About(
            cell=cell.model_copy(update={"name": text(cell.name)}),
            policy=metadata["policy"],
            started_at=_within(float(metadata["started_at"]), 0, LATEST),
            checkpoint_sha256=metadata.get("checkpoint_sha256"),
            seed=None if seed is None else _within(int(seed), 0, 2**63 - 1),
            command=metadata.get("command", ""),
            scene=None if scene is None else scene.decode(),
            commit=metadata.get("commit"),
            versions={name: text(version) for name, version in versions.items()},
        )
    except KeyError as error:
        raise LogError(f"the head of the log is incomplete: {error} is missing") from error
    except (ValueError, OverflowError, RecursionError, ConfigError) as error:
        raise LogError(f"the head of the log cannot be read: {error}") from error


def _within(value: N, low: float, high: float) -> N:
    """Raises ValueError; nan lies nowhere."""
    if not low <= value <= high:
        raise ValueError(f"{value:.6g} is not between {low:.6g} and {high:.6g}")
    return value
