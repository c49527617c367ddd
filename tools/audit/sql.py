"""SQL over the tables, by DuckDB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import duckdb

from tdpg_deploy.errors import ConfigError
from tools.audit.parquet import ACTIONS, EPISODES

MAX_ROWS = 1_000  # of an answer that are shown


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Of a query. more: whether rows were left out."""

    columns: tuple[str, ...]
    rows: Sequence[tuple[Any, ...]]
    more: bool


def query(folder: Path, sql: str) -> Answer:
    """Ask the tables `episodes` and `actions`. Raises ConfigError with DuckDB's complaint."""
    with duckdb.connect() as connection:
        for name, file in (("episodes", EPISODES), ("actions", ACTIONS)):
            connection.from_parquet(str(folder / file)).create_view(name)
        try:
            result = connection.execute(sql)
            rows = result.fetchmany(MAX_ROWS + 1)
        except duckdb.Error as error:
            raise ConfigError(f"--sql: {error}") from error
        columns = tuple(str(column[0]) for column in result.description or ())
    return Answer(columns=columns, rows=rows[:MAX_ROWS], more=len(rows) > MAX_ROWS)
