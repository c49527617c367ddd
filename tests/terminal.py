"""A program in a terminal, as a person meets it."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import time
from collections.abc import Sequence
from types import TracebackType

LIMIT = 180.0  # s; a loaded machine takes a minute to start a program


class Terminal:
    """`with Terminal(command) as terminal: terminal.wait_for("Go?"); terminal.type("y\\n")`."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self._seen = b""

    def __enter__(self) -> Terminal:
        self._ours, theirs = pty.openpty()
        self._process = subprocess.Popen(
            ["setsid", "--ctty", *self._command],  # so that Ctrl-C goes to it, and to nobody else
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env={**os.environ, "COLUMNS": "200", "TERM": "xterm"},
        )
        os.close(theirs)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._ours)

    def wait_for(self, text: str) -> None:
        """Read on until this was printed."""
        end = time.monotonic() + LIMIT
        while text.encode() not in self._seen:
            assert time.monotonic() < end, f"{text!r} is not in {self._seen!r}"
            self._read(end)
        self._seen = self._seen.partition(text.encode())[2]

    def type(self, text: str) -> None:
        os.write(self._ours, text.encode())

    def exit_code(self) -> int:
        """Once the program has ended."""
        end = time.monotonic() + LIMIT
        while (code := self._process.poll()) is None:
            assert time.monotonic() < end, f"it goes on after {self._seen!r}"
            self._read(time.monotonic() + 0.05)
        return code

    def _read(self, end: float) -> None:
        if select.select([self._ours], [], [], max(end - time.monotonic(), 0))[0]:
            try:
                self._seen += os.read(self._ours, 4096)
            except OSError:  # the other end is closed
                time.sleep(0.01)
