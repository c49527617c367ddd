"""The wires of the emulated 2F-85: a pseudo-terminal, RTU through TCP, the URCap's socket.

One thread serves any number of them in front of one gripper:

    with RobotiqEmulator(RobotiqModel(KinematicJaws(time.time), time.time)) as emulator:
        port = emulator.serve_pty()                            # "/dev/pts/3"
        host, port = emulator.serve_rtu_over_tcp("127.0.0.1")  # an ephemeral port
        host, port = emulator.serve_urcap("127.0.0.1")
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import threading
import tty
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Any, TypeAlias, TypeVar, cast

from tdpg_deploy.emulators.robotiq import RobotiqModel
from tdpg_deploy.emulators.robotiq_modbus import answer, split_request
from tdpg_deploy.emulators.robotiq_urcap import REFUSED, reply_to

UNIT_ID = 9
START_LIMIT = 5.0  # s to open or close a wire
TICK = 0.005  # s between looks at the fingers

T = TypeVar("T")

# What the line does to an answer: seconds of (real) delay, and the bytes that arrive.
Line: TypeAlias = Callable[[bytes], tuple[float, bytes]]


def clean(sent: bytes) -> tuple[float, bytes]:
    return 0.0, sent


def mute(_sent: bytes) -> tuple[float, bytes]:
    return 0.0, b""


def corrupt(sent: bytes) -> tuple[float, bytes]:
    """One bit of the last byte flips: for RTU, in the checksum."""
    return 0.0, sent[:-1] + bytes([sent[-1] ^ 0x10])


def late(seconds: float) -> Line:
    return lambda sent: (seconds, sent)


def first(count: int, faulty: Line) -> Line:
    """Faulty for the first `count` answers, then clean."""
    left = itertools.count(count, -1)
    return lambda sent: faulty(sent) if next(left) > 0 else clean(sent)


class RobotiqEmulator:
    """Serves `model` until closed. `line` may be changed at any time; `refusing` makes the
    URCap answer `?`, as while the arm is emergency-stopped."""

    def __init__(self, model: RobotiqModel) -> None:
        self.model = model
        self.line: Line = clean
        self.refusing = False
        self._connections: set[_Connection] = set()
        self._servers: list[asyncio.Server] = []
        self._ptys: list[tuple[int, int]] = []
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._loop.call_soon_threadsafe(self._tick)

    def __enter__(self) -> RobotiqEmulator:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def serve_pty(self) -> str:
        """A serial line; returns its path."""
        return self._run(self._open_pty())

    def serve_rtu_over_tcp(self, host: str, port: int = 0) -> tuple[str, int]:
        """RTU frames through TCP; returns the address."""
        return self._run(self._listen(host, port, self._answer_rtu))

    def serve_urcap(self, host: str, port: int = 0) -> tuple[str, int]:
        """The URCap's text socket; returns the address."""
        return self._run(self._listen(host, port, self._answer_urcap))

    @property
    def connections(self) -> int:
        """TCP clients at present."""
        return len(self._connections)

    def hang_up(self) -> None:
        """Drop all TCP connections; new ones are welcome."""
        self._run(self._drop())

    def close(self) -> None:
        """Close every wire. May be called twice."""
        if self._loop.is_closed():
            return
        self._run(self._shut())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(START_LIMIT)
        self._loop.close()

    # --- in the serving thread ----------------------------------------------------------------

    def _run(self, task: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(task, self._loop).result(START_LIMIT)

    def _tick(self) -> None:
        self.model.advance()
        self._loop.call_later(TICK, self._tick)

    async def _open_pty(self) -> str:
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        # The slave's end stays open here: else the line hangs up whenever a client closes it.
        self._ptys.append((master, slave))
        received = b""

        def receive() -> None:
            nonlocal received
            received = self._answer_rtu(received + os.read(master, 4096), write)

        def write(sent: bytes) -> None:
            with contextlib.suppress(OSError):  # nobody listens, or the line is gone by now
                os.write(master, sent)

        self._loop.add_reader(master, receive)
        return os.ttyname(slave)

    async def _listen(self, host: str, port: int, answer: _Answer) -> tuple[str, int]:
        server = await self._loop.create_server(
            lambda: _Connection(answer, self._connections), host, port
        )
        self._servers.append(server)
        return cast("tuple[str, int]", server.sockets[0].getsockname())

    async def _drop(self) -> None:
        for connection in list(self._connections):
            connection.transport.abort()

    async def _shut(self) -> None:
        for server in self._servers:
            server.close()
        await self._drop()
        await asyncio.sleep(0)  # lets the aborted connections say goodbye
        for master, slave in self._ptys:
            self._loop.remove_reader(master)
            os.close(master)
            os.close(slave)

    def _answer_rtu(self, received: bytes, write: _Write) -> bytes:
        while True:
            request, received = split_request(received)
            if request is None:
                return received
            if request.unit == UNIT_ID and self.model.powered:
                self._send(answer(request, self.model), write)

    def _answer_urcap(self, received: bytes, write: _Write) -> bytes:
        *lines, rest = received.split(b"\n")
        for line in lines:
            able = self.model.powered and not self.refusing
            text = line.decode("ascii", "replace")
            self._send(reply_to(text, self.model) if able else REFUSED, write)
        return rest

    def _send(self, sent: bytes, write: _Write) -> None:
        delay, arriving = self.line(sent)
        if arriving:
            self._loop.call_later(delay, write, arriving)


_Write: TypeAlias = Callable[[bytes], None]
# Takes all that was received and not yet used, writes the answers, returns what is left over.
_Answer: TypeAlias = Callable[[bytes, _Write], bytes]


class _Connection(asyncio.Protocol):
    """One TCP client."""

    transport: asyncio.Transport

    def __init__(self, answer: _Answer, peers: set[_Connection]) -> None:
        self._answer = answer
        self._peers = peers
        self._received = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self._peers.add(self)

    def data_received(self, data: bytes) -> None:
        self._received = self._answer(self._received + data, self.transport.write)

    def connection_lost(self, _error: Exception | None) -> None:
        self._peers.discard(self)
