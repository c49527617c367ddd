"""A controller in a process of its own, for programs and tests that talk to it over TCP.

It must be another process: ur_rtde's constructors hold the interpreter lock while they wait.
"""

from __future__ import annotations

import json
import select
import subprocess
import sys
from types import TracebackType
from typing import Any

from tdpg_deploy.errors import DeviceTimeout, DeviceUnreachable

_START_DEADLINE = 60.0  # s
_COMMAND_DEADLINE = 30.0  # s


class ControllerProcess:
    """`with ControllerProcess(host=..., generation=...) as robot: robot.do("protective_stop")`."""

    def __init__(self, **options: object) -> None:
        """`options` of `python -m tdpg_deploy.emulators.ur_controller`; True for a switch."""
        self._command = [sys.executable, "-m", "tdpg_deploy.emulators.ur_controller"]
        for name, value in options.items():
            self._command += [f"--{name}"] if value is True else [f"--{name}", str(value)]
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> ControllerProcess:
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        try:
            self._answer(_START_DEADLINE)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def close(self) -> None:
        """End the process; it has no other life than its stdin."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.close()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()

    def do(self, name: str, **arguments: object) -> Any:
        """Perform a command of pendant.py. Raises DeviceTimeout or DeviceUnreachable."""
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": name, **arguments}) + "\n")
        return self._answer(_COMMAND_DEADLINE)

    def _answer(self, deadline: float) -> Any:
        assert self._process is not None
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], deadline)[0]:
            raise DeviceTimeout(f"the emulated controller gave no answer within {deadline} s")
        line = self._process.stdout.readline()
        if not line:
            code = self._process.wait()
            raise DeviceUnreachable(f"the emulated controller ended with exit code {code}")
        answer = json.loads(line)
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer["ok"]
