"""Records -> Parquet."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, fields
from datetime import datetime
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, get_type_hints

import pyarrow as pa
import pyarrow.parquet as pq

from tdpg_deploy.errors import ConfigError
from tools.audit.rows import ActionRecord, AuditedLog, EpisodeRecord

EPISODES, ACTIONS = "episodes.parquet", "actions.parquet"
BATCH = 5_000  # actions in memory before they are written

_TYPES: dict[Any, pa.DataType] = {
    str: pa.string(),
    int: pa.int64(),
    bool: pa.bool_(),
    float: pa.float64(),
    datetime: pa.timestamp("us", tz="UTC"),
    str | None: pa.string(),
    int | None: pa.int64(),
    bool | None: pa.bool_(),
    tuple[str, ...]: pa.list_(pa.string()),
}


@cache
def schema(kind: type) -> pa.Schema:
    """Of a record's dataclass."""
    hints = get_type_hints(kind)
    return pa.schema([(field.name, _TYPES[hints[field.name]]) for field in fields(kind)])


class TableWriter:
    """Writes both tables into a folder as the logs come in, and holds no more than a batch."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._episodes: list[EpisodeRecord] = []
        self._actions: list[ActionRecord] = []

    def __enter__(self) -> TableWriter:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._episode_file = pq.ParquetWriter(self._folder / EPISODES, schema(EpisodeRecord))
            self._action_file = pq.ParquetWriter(self._folder / ACTIONS, schema(ActionRecord))
        except OSError as error:
            raise ConfigError(f"{self._folder}: cannot be written ({error})") from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._flush()
        self._episode_file.close()
        self._action_file.close()

    def add(self, log: AuditedLog) -> None:
        self._episodes.append(log.episode)
        self._actions += log.actions
        if len(self._actions) + len(self._episodes) >= BATCH:
            self._flush()

    def _flush(self) -> None:
        self._episode_file.write_table(_table(EpisodeRecord, self._episodes))
        self._action_file.write_table(_table(ActionRecord, self._actions))
        self._episodes, self._actions = [], []


def _table(kind: type, records: Iterable[EpisodeRecord | ActionRecord]) -> pa.Table:
    return pa.Table.from_pylist([asdict(record) for record in records], schema=schema(kind))
