"""What a benchmark yields."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """One figure: median of `repeats`, with the 5th and 95th percentile as spread.

    reference: the same figure of something to compare with, measured in the same run.
    """

    name: str
    unit: str
    median: float
    low: float
    high: float
    repeats: int
    reference: float | None = None

    @property
    def ratio(self) -> float | None:
        """Median over reference: below one is better than the reference."""
        return None if self.reference is None else self.median / self.reference


def timed(
    name: str, call: Callable[[], object], *, repeats: int, reference: float | None = None
) -> Measurement:
    """Wall time of `call` in milliseconds, after one call to warm up."""
    call()
    values = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        values.append((time.perf_counter() - start) * 1e3)
    low, median, high = (float(value) for value in np.percentile(values, (5, 50, 95)))
    return Measurement(
        name=name,
        unit="ms",
        median=median,
        low=low,
        high=high,
        repeats=repeats,
        reference=reference,
    )
