"""Where a live replay stands in the log's time: playing, paused, faster, elsewhere."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from math import inf
from typing import Protocol, TypeVar

TICK = 0.02  # s between looks at the playhead


class _Timed(Protocol):
    @property
    def log_time(self) -> int: ...

    @property
    def topic(self) -> str: ...


M = TypeVar("M", bound=_Timed)


class Playhead:
    """Times are nanoseconds of the log. A viewer moves it from its own thread.

    now: this machine's clock, seconds. jumps: how often it was moved to another place.
    """

    def __init__(self, start: int, *, speed: float, now: Callable[[], float]) -> None:
        self.jumps = 0
        self.playing = True
        self.speed = speed
        self._now = now
        self._lock = threading.Lock()
        self._anchor = start, now()

    @property
    def time(self) -> int:
        with self._lock:
            return self._time()

    @property
    def start(self) -> int:
        """Where it was when it was last moved, paused or let go."""
        with self._lock:
            return self._anchor[0]

    def control(self, *, play: bool, speed: float, seek: int | None) -> None:
        """What a viewer asks for. seek: go there. A speed that is none changes nothing."""
        with self._lock:
            here = self._time() if seek is None else seek
            self._anchor = here, self._now()
            self.playing = play
            if 0 < speed < inf:
                self.speed = speed
            self.jumps += seek is not None

    def _time(self) -> int:
        start, since = self._anchor
        passed = (self._now() - since) * self.speed if self.playing else 0.0
        return start + int(passed * 1e9)


def play(
    messages: Iterable[M],
    publish: Callable[[M], None],
    playhead: Playhead,
    sleep: Callable[[float], None],
) -> bool:
    """Publish each message when the playhead reaches it; first, the last one of every topic from
    before. Returns False when the playhead jumped: play again from the first message."""
    jumps, start = playhead.jumps, playhead.start
    earlier: dict[str, M] = {}
    for message in messages:
        if message.log_time < start:
            earlier[message.topic] = message
            continue
        _publish_all(earlier, publish)
        while playhead.time < message.log_time and playhead.jumps == jumps:
            sleep(TICK)
        if playhead.jumps != jumps:
            return False
        publish(message)
    _publish_all(earlier, publish)
    return True


def _publish_all(earlier: dict[str, M], publish: Callable[[M], None]) -> None:
    for message in earlier.values():
        publish(message)
    earlier.clear()
