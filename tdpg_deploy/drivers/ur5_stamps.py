"""When samples were taken, by the clock of the cell."""

from __future__ import annotations

from collections import deque

WINDOW = 2.0  # s; within it the two clocks drift by less than a millisecond


class Stamps:
    """The controller's times, moved by the least delay seen lately: what comes late over the
    network or out of a busy process was not measured late."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque()  # received, received - timestamp

    def stamp(self, timestamp: float, received: float) -> float:
        """Of a sample with the controller's `timestamp`, on the clock that tells `received`."""
        self._seen.append((received, received - timestamp))
        while self._seen[0][0] < received - WINDOW:
            self._seen.popleft()
        return timestamp + min(offset for _, offset in self._seen)
