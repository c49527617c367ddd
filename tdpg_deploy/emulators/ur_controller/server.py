"""The three servers of a controller on one address, in one asyncio loop with the control cycle."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

from tdpg_deploy.emulators.ur_controller import dashboard
from tdpg_deploy.emulators.ur_controller.controller import Controller
from tdpg_deploy.emulators.ur_controller.rtde_session import Claims, RtdeSession
from tdpg_deploy.emulators.ur_controller.rtde_wire import WireError, split
from tdpg_deploy.emulators.ur_controller.script import split_programs

DASHBOARD_PORT = 29999  # fixed in the real controller, and in ur_rtde
SCRIPT_PORT = 30003
RTDE_PORT = 30004
MADE_UP_FOR = 0.3  # s by which the control cycle may be late and still catch up

Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class Server:
    """Serves a controller and runs its control cycle."""

    def __init__(self, controller: Controller, host: str) -> None:
        self.controller, self._host = controller, host
        self._claims = Claims()
        self._sessions: dict[RtdeSession, asyncio.StreamWriter] = {}
        self._writers: set[asyncio.StreamWriter] = set()
        self._listeners: list[asyncio.Server] = []
        self._thawed = asyncio.Event()
        self._thawed.set()

    # --- the network as it fails --------------------------------------------------------------

    async def listen(self) -> None:
        """Accept clients. Raises OSError when a port of the address is taken."""
        handlers = {
            DASHBOARD_PORT: self._serve_dashboard,
            SCRIPT_PORT: self._serve_script,
            RTDE_PORT: self._serve_rtde,
        }
        for port, handler in handlers.items():
            self._listeners.append(
                await asyncio.start_server(self._tracked(handler), self._host, port)
            )

    async def unplug(self) -> None:
        """Refuse new clients, and cut off those who are connected."""
        for listener in self._listeners:
            listener.close()
        self._listeners.clear()
        self.drop()

    def drop(self) -> None:
        """Cut off every client; they may come back at once."""
        for writer in self._writers:
            writer.transport.abort()

    def freeze(self) -> None:
        """Accept clients and hear them, and never answer. The control cycle goes on."""
        self._thawed.clear()

    def thaw(self) -> None:
        self._thawed.set()

    # --- control cycle ------------------------------------------------------------------------

    async def run(self, *, pace: float) -> None:
        """Cycle for ever, `pace` times as fast as the clock; up to MADE_UP_FOR late."""
        loop = asyncio.get_running_loop()
        period = self.controller.dt / pace
        due = loop.time()
        while True:
            self.cycle()
            due = max(due + period, loop.time() - MADE_UP_FOR)
            await asyncio.sleep(max(due - loop.time(), 0))  # clients are heard in any case

    def cycle(self) -> None:
        """One control period; for those who keep time themselves."""
        self.controller.cycle()
        if self._thawed.is_set():
            for session, writer in self._sessions.items():
                if package := session.due():
                    writer.write(package)

    # --- clients ------------------------------------------------------------------------------

    def _tracked(self, handler: Handler) -> Handler:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            self._writers.add(writer)
            try:
                await self._thawed.wait()
                await handler(reader, writer)
            except (ConnectionError, asyncio.IncompleteReadError, WireError):
                pass  # the client is gone, or talks nonsense: hang up
            finally:
                self._writers.discard(writer)
                writer.close()
                with contextlib.suppress(ConnectionError):
                    await writer.wait_closed()

        return serve

    async def _serve_dashboard(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        writer.write(f"{dashboard.GREETING}\n".encode())
        while line := await reader.readline():
            await self._thawed.wait()
            reply = dashboard.answer(line.decode("utf-8", "replace"), self.controller)
            writer.write(f"{reply}\n".encode())

    async def _serve_script(self, reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
        text = ""
        while data := await reader.read(65536):
            await self._thawed.wait()
            programs, text = split_programs(text + data.decode("utf-8", "replace"))
            for program in programs:
                self.controller.upload(program)

    async def _serve_rtde(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        session = RtdeSession(self.controller, self._claims)
        self._sessions[session] = writer
        buffer = b""
        try:
            while data := await reader.read(65536):
                await self._thawed.wait()
                packages, buffer = split(buffer + data)
                for package in packages:
                    if reply := session.answer(package):
                        writer.write(reply)
        finally:
            del self._sessions[session]
            session.close()
