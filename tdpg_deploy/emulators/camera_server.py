"""The camera of an emulated cell: pictures of the world that the arm moves in, served."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.emulators.frame_wire import encode
from tdpg_deploy.hal import Clock, RgbdFrame
from tdpg_deploy.sim.camera import SimCamera
from tdpg_deploy.sim.pieces import VisiblePiece
from tdpg_deploy.sim.world import World


class _Still:
    """A `sim.camera.VisibleWorld` as it was at one instant."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.pieces: Sequence[VisiblePiece] = ()

    def visible(self) -> Sequence[VisiblePiece]:
        return self.pieces


class CameraServer:
    """Serves frames from the event loop that steps the world.

    The world is looked at between two steps; its picture is then drawn in a thread, so that the
    arm's control cycle goes on.
    """

    def __init__(self, world: World, config: CellConfig, *, seed: int) -> None:
        self._world = world
        self._still = _Still(world.clock)
        single = config.camera.model_copy(update={"frames_averaged": 1})  # the driver averages
        self._camera = SimCamera(
            self._still, config.model_copy(update={"camera": single}), seed=seed
        )
        self._camera.connect()
        self._drawing = ThreadPoolExecutor(1, thread_name_prefix="camera")
        self._awake = asyncio.Event()
        self._awake.set()
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.Task[None]] = set()
        self._freezes = False
        self._frozen: tuple[RgbdFrame, float] | None = None  # and when it was drawn
        self._color_late = 0.0  # s
        self._without_depth = 0.0  # share of the picture

    async def listen(self, host: str, port: int) -> None:
        """Raises OSError when the port is taken."""
        await self._picture()  # what is compiled on first use would make the first client wait
        self._server = await asyncio.start_server(self._serve, host, port)

    def stall(self) -> None:
        """Accept clients and send nothing, until `resume`."""
        self._awake.clear()

    def freeze(self) -> None:
        """Send the next picture again and again, as it ages, until `resume`."""
        self._freezes = True

    def tear(self, seconds: float) -> None:
        """Send colour that is older than its depth, until `resume`."""
        self._color_late = seconds

    def blind(self, share: float) -> None:
        """Send no depth in the left `share` of the picture, until `resume`."""
        self._without_depth = share

    def resume(self) -> None:
        self._awake.set()
        self._freezes, self._frozen = False, None
        self._color_late = self._without_depth = 0.0

    async def unplug(self) -> None:
        """Cut off all clients, and refuse others until `listen`."""
        if self._server is not None:
            self._server.close()
        for client in self._clients:
            client.cancel()
        await asyncio.gather(*self._clients, return_exceptions=True)

    async def close(self) -> None:
        """May be called twice."""
        await self.unplug()
        self._drawing.shutdown()

    async def _serve(self, _: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = asyncio.current_task()
        assert client is not None
        self._clients.add(client)
        try:
            await self._awake.wait()
            writer.write(await self._picture())
            await writer.drain()
        except (ConnectionError, asyncio.CancelledError):
            pass  # the client is gone, or we go; Python 3.11 reports a handler that was cancelled
        finally:
            self._clients.discard(client)
            writer.close()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()

    async def _picture(self) -> bytes:
        pieces = self._world.visible()
        return await asyncio.get_running_loop().run_in_executor(self._drawing, self._draw, pieces)

    def _draw(self, pieces: Sequence[VisiblePiece]) -> bytes:
        now = time.monotonic()
        if self._frozen is not None:
            frame, drawn_at = self._frozen
            return encode(frame, ages=(now - drawn_at, now - drawn_at))
        self._still.pieces = pieces
        frame = self._camera.capture()
        frame.depth[:, : round(self._without_depth * frame.depth.shape[1])] = np.nan
        if self._freezes:
            self._frozen = (frame, now)
        return encode(frame, ages=(self._color_late, 0.0))
