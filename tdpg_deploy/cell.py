"""A cell, simulated or real: the sole place that knows which."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from types import TracebackType

from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.hal import Arm, Camera, Clock, Gripper

Truth = Callable[[], Mapping[str, int]]


class Cell:
    """Devices of one cell. `with cell:` connects them; on any exit the arm is stopped and all
    are closed, the last one first, even when one of them fails.

    truth: counts that only a simulated world knows; for judging, never for deciding.
    """

    def __init__(
        self,
        *,
        config: CellConfig,
        camera: Camera,
        arm: Arm,
        gripper: Gripper,
        clock: Clock,
        truth: Truth | None = None,
        release: Callable[[], None] | None = None,
    ) -> None:
        self.config = config
        self.camera = camera
        self.arm = arm
        self.gripper = gripper
        self.clock = clock
        self.truth = truth
        self._release = release
        self._exits = ExitStack()

    def __enter__(self) -> Cell:
        with ExitStack() as exits:
            if self._release is not None:
                exits.callback(self._release)
            for device in (self.camera, self.arm, self.gripper):
                exits.callback(device.close)  # also when its connect fails half-way
                device.connect()
            exits.callback(self.arm.stop)
            self._exits = exits.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._exits.__exit__(kind, error, traceback)


class MachineClock:
    """This machine's time; never steps back when the wall clock is set."""

    def __init__(self) -> None:
        self._offset = time.time() - time.monotonic()

    def now(self) -> float:
        return time.monotonic() + self._offset

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)
