"""Which records nothing is learnt from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from tdpg_deploy.errors import ConfigError

EVERY = 10  # so many-th record

Record = TypeVar("Record")


def split(records: Sequence[Record], size: int) -> tuple[list[Record], list[Record]]:
    """To learn from, and held out: every so many-th, or the last where there are fewer. size: of a
    record, for the message. Raises ConfigError for fewer than two."""
    if len(records) < 2:
        raise ConfigError(
            f"{size} are too few to learn from some and be judged by others: give {size + 1} or "
            "more as --actions"
        )
    out = range(EVERY - 1, len(records), EVERY) or range(len(records) - 1, len(records))
    return (
        [record for number, record in enumerate(records) if number not in out],
        [records[number] for number in out],
    )
