"""Records of what was played: arrays by name, one file each."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TypeVar

import numpy as np

from tools.train.whole import written_whole

SomeRecord = TypeVar("SomeRecord", bound="Record")


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """All fields are arrays."""

    def save(self, path: Path) -> None:
        with written_whole(path) as file:
            np.savez(file, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls: type[SomeRecord], path: Path) -> SomeRecord:
        with np.load(path, allow_pickle=False) as arrays:
            return cls(**{field.name: arrays[field.name] for field in fields(cls)})
