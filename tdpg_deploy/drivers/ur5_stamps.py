"""When samples were taken, by the clock of the cell."""

from __future__ import annotations

import math
from collections import deque

WINDOW = 2.0  # s; within it the two clocks drift by less than a millisecond
STEP = 1e-6  # s, where a shorter delay than all before would make time step back


class Stamps:
    """The controller's times, moved by the least delay seen lately: what comes late over the
    network or out of a busy process was not measured late. They only grow."""

    def __init__(self) -> None:
        self._last = -math.inf
        self._seen: deque[tuple[float, float]] = deque()  # received, received - timestamp

    def stamp(self, timestamp: float, received: float) -> float:
        """Of a sample with the controller's `timestamp`, on the clock that tells `received`."""
        self._seen.append((received, received - timestamp))
        while self._seen[0][0] < received - WINDOW:
            self._seen.popleft()
        stamp = timestamp + min(offset for _, offset in self._seen)
        self._last = max(stamp, self._last + STEP)
        return self._last
