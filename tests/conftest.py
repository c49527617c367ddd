"""Tests in real time, on machines that are busy. Its place puts tests/ on the path as well.

What is marked `real_time` talks to another process under deadlines of half a second, as on a
real cell. When it fails while this machine let a waiting thread wait a tenth of a second longer
than asked, the machine was tested and not the driver: it is run again.
"""

from __future__ import annotations

import signal
import threading
import time
from types import TracebackType

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings

settings.register_profile("timeless", deadline=None)  # a busy machine is not a wrong result
settings.load_profile("timeless")

ATTEMPTS = 4
STALL = 0.1  # s
_TICK = 0.01  # s


class Stalls:
    """Watches how late a sleeping thread wakes; `longest` in s."""

    def __enter__(self) -> Stalls:
        self.longest = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        before = time.monotonic()
        while not self._over.wait(_TICK):
            now = time.monotonic()
            self.longest = max(self.longest, now - before - _TICK)
            before = now


def pytest_configure(config: pytest.Config) -> None:
    # A shell that starts pytest in the background has it ignore Ctrl-C, which some tests press.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    config.addinivalue_line("markers", "real_time: run again when the machine stalled meanwhile")


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    if item.get_closest_marker("real_time") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for _ in range(ATTEMPTS):
        with Stalls() as stalls:
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
        if not any(report.failed for report in reports) or stalls.longest < STALL:
            break
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True
