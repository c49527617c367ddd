"""tdpg-emulate as a process, for programs and tests that drive a cell without a robot."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

from tdpg_deploy.cell_config import CellConfig, load_cell
from tdpg_deploy.emulators.cell_file import format_cell
from tdpg_deploy.errors import DeviceTimeout, DeviceUnreachable

START_LIMIT = 60.0  # s
ANSWER_LIMIT = 20.0  # s
END_LIMIT = 60.0  # s; a loaded machine takes its time to end an interpreter


class CellProcess:
    """`with CellProcess(config, "--objects", "5") as cell: cell.do("protective_stop")`.

    file: the cell file to connect with, while the process lives.
    """

    def __init__(self, config: CellConfig, *arguments: str | Path) -> None:
        """`arguments` of tdpg-emulate, beside the cell file."""
        self._asked = config
        self._arguments = [str(argument) for argument in arguments]
        self._exits = ExitStack()

    def __enter__(self) -> CellProcess:
        with ExitStack() as exits:
            directory = Path(exits.enter_context(TemporaryDirectory(prefix="tdpg-emulate-")))
            asked, self.file = directory / "asked.toml", directory / "cell.toml"
            asked.write_text(format_cell(self._asked), encoding="utf-8")
            command = [sys.executable, "-m", "tdpg_deploy.cli.emulate", str(asked)]
            self._process = subprocess.Popen(
                [*command, *self._arguments, "--write-config", str(self.file)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env={**os.environ, "OMP_NUM_THREADS": "1"},  # it is to leave room for its clients
            )
            exits.callback(self._end)
            self._greeting()
            self._exits = exits.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._exits.__exit__(kind, error, traceback)

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    @property
    def config(self) -> CellConfig:
        """To connect with."""
        return load_cell(self.file)

    def type(self, line: str) -> dict[str, Any]:
        """What is answered to a command, such as `speed_slider share=0.5`."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._line(ANSWER_LIMIT))
        return answer

    def do(self, line: str) -> Any:
        """What a command returns. Raises ValueError when it is refused."""
        answer = self.type(line)
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer["ok"]

    def _greeting(self) -> None:
        """Written at once: its first line alone has to be waited for."""
        line = self._line(START_LIMIT)
        assert self._process.stdout is not None
        while line and not line.startswith("commands"):
            line = self._process.stdout.readline()

    def _line(self, deadline: float) -> str:
        """The only line of an answer, or the first."""
        stdout = self._process.stdout
        assert stdout is not None
        if not select.select([stdout], [], [], deadline)[0]:
            raise DeviceTimeout(f"the emulated cell gave no answer within {deadline} s")
        line = stdout.readline()
        if not line:
            raise DeviceUnreachable(
                f"tdpg-emulate ended with exit code {self._process.wait(END_LIMIT)}"
            )
        return line

    def _end(self) -> None:
        """By Ctrl-C."""
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(END_LIMIT)
        finally:
            self._process.kill()
            self._process.communicate()
