"""The simulated D435: the renderer through a D435's lens, with a D435's errors of depth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from tdpg_deploy.averaging import mean_depth
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.errors import CameraError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Clock, Intrinsics, RgbdFrame
from tdpg_deploy.sim.depth_noise import Depth, with_stereo_noise
from tdpg_deploy.sim.pieces import VisiblePiece
from tdpg_deploy.sim.render import Lighting, render

# Colour stream. D400 series data sheet: horizontal field of view 69.4 degrees, so fx = 924 at
# 1280 pixels; single cameras report 900 to 930, and centres some pixels off. 640 x 480 is the
# middle 960 x 720 of the same picture, made smaller by 2/3.
COLOR_1280 = Intrinsics(width=1280, height=720, fx=922.0, fy=922.0, cx=643.0, cy=357.5)
COLOR_640 = Intrinsics(
    width=640,
    height=480,
    fx=COLOR_1280.fx * 2 / 3,
    fy=COLOR_1280.fy * 2 / 3,
    cx=(COLOR_1280.cx - 160 + 0.5) * 2 / 3 - 0.5,
    cy=(COLOR_1280.cy + 0.5) * 2 / 3 - 0.5,
)

DEPTH_UNIT = np.float32(0.001)  # m a count of the 16 bits of depth, as a D435 comes


class VisibleWorld(Protocol):
    """What the camera needs of a world."""

    @property
    def clock(self) -> Clock: ...

    def visible(self) -> Sequence[VisiblePiece]: ...


class SimCamera:
    """hal.Camera. The same seed gives the same noise, frame by frame."""

    def __init__(self, world: VisibleWorld, config: CellConfig, *, seed: int = 0) -> None:
        self._world = world
        self._config = config
        self._rng = np.random.default_rng(seed)
        self._connected = False
        self._sequence = 0

    @property
    def intrinsics(self) -> Intrinsics:
        return {640: COLOR_640, 1280: COLOR_1280}[self._config.camera.width]

    def connect(self) -> None:
        self._connected = True

    def close(self) -> None:
        self._connected = False

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        """Takes no time of the cell's. Depth is the mean over `camera.frames_averaged` frames."""
        if not self._connected:
            raise CameraError("the simulated camera is not connected: call connect() first")
        simulation, intrinsics = self._config.simulation, self.intrinsics
        seen = render(
            self._world.visible(),
            intrinsics,
            true_pose(self._config),
            Lighting(direction=simulation.light),
        )
        depth = as_counted(seen.depth)
        if simulation.depth_noise:
            depth = mean_depth(
                [
                    as_counted(with_stereo_noise(seen.depth, seen.color, intrinsics, self._rng))
                    for _ in range(self._config.camera.frames_averaged)
                ]
            )
        self._sequence += 1
        return RgbdFrame(
            color=seen.color,
            depth=depth,
            intrinsics=intrinsics,
            captured_at=self._world.clock.now(),
            sequence=self._sequence,
            serial="simulated",
        )


def as_counted(depth: Depth) -> Depth:
    """Depth (m, nan where unknown) as it arrives over the wire: whole counts, 0 for unknown."""
    counts = np.rint(np.nan_to_num(depth, nan=0.0, posinf=0.0) / DEPTH_UNIT)
    counts[(counts < 1) | (counts > np.iinfo(np.uint16).max)] = np.nan
    return np.asarray(counts * DEPTH_UNIT, np.float32)


def true_pose(config: CellConfig) -> Transform:
    """X_base_camera where the camera really stands, whatever the calibration says."""
    return (config.simulation.X_base_camera or config.camera.X_base_camera).transform()
