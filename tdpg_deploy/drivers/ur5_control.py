"""The parent's end of ur5_child.py: requests with deadlines to a process that may be killed."""

from __future__ import annotations

import multiprocessing
import signal
import subprocess
import sys
import time
from multiprocessing.connection import Connection
from typing import Any

from tdpg_deploy.errors import ArmError, DeviceTimeout, DeviceUnreachable


class ControlProcess:
    """A child process that holds ur_rtde's connections to `host`."""

    def __init__(self, host: str) -> None:
        self._host = host
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._number = 0

    @property
    def is_alive(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def start(self, *, deadline: float) -> None:
        """Spawn the child and connect. Raises DeviceTimeout, DeviceUnreachable or ArmError."""
        self.kill()
        self._connection, theirs = multiprocessing.Pipe()
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "tdpg_deploy.drivers.ur5_child"),
                *(str(theirs.fileno()), self._host),
            ],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # ur_rtde chats
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the parent, which still has to stop the arm
        )
        theirs.close()
        self._number = 0
        try:
            self._await_answer("connecting", deadline)
        except ArmError:
            self.kill()
            raise

    def call(self, name: str, *arguments: object, deadline: float = 4.0) -> Any:
        """The result of a `Session` method. The child is killed when it does not answer."""
        connection = self._started()
        self._number += 1
        try:
            connection.send((self._number, name, arguments))
        except OSError as error:
            raise self._died() from error
        return self._await_answer(name, deadline)

    def require_started(self) -> None:
        """Raises DeviceUnreachable where there is nothing to call, and so nothing to stop."""
        self._started()

    def _started(self) -> Connection:
        if self._connection is None:
            raise DeviceUnreachable("the arm is not connected: call connect() or recover()")
        return self._connection

    def kill(self) -> None:
        """End the child now, whatever it does. The controller's watchdog stops the arm."""
        if self._connection is not None:
            self._connection.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._connection = self._process = None

    def _await_answer(self, request: str, deadline: float) -> Any:
        assert self._connection is not None
        end = time.monotonic() + deadline
        try:
            while self._connection.poll(max(end - time.monotonic(), 0)):
                number, error, result = self._connection.recv()
                if number != self._number:
                    continue  # of a call that Ctrl-C interrupted
                if error is not None:
                    raise ArmError(f"ur_rtde refused {request}: {error}")
                return result
        except (EOFError, OSError) as lost:
            raise self._died() from lost
        self.kill()
        raise DeviceTimeout(
            f"ur_rtde gave no answer to {request} within {deadline:.1f} s and was ended: the link "
            "hangs, or another program runs on the controller; check both, then call recover()"
        )

    def _died(self) -> DeviceUnreachable:
        assert self._process is not None
        try:
            code = self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            code = 0
        self.kill()
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        return DeviceUnreachable(
            f"the process that holds ur_rtde ended {how}, as it does when the link to the "
            "controller drops: check cable and controller, then call recover()"
        )
