"""The simulated D435."""

from __future__ import annotations

import numpy as np

from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.hal import Intrinsics, RgbdFrame
from tdpg_deploy.sim.depth_noise import with_stereo_noise
from tdpg_deploy.sim.render import Lighting, render
from tdpg_deploy.sim.world import World


class SimCamera:
    def __init__(self, world: World, config: CellConfig) -> None:
        self._world = world
        self._config = config
        self._sequence = 0
        self._rng = np.random.default_rng(0)
        self.intrinsics = (
            Intrinsics(width=640, height=480, fx=615.0, fy=615.0, cx=320.5, cy=239.5)
            if config.camera.width == 640
            else Intrinsics(width=1280, height=720, fx=922.0, fy=922.0, cx=640.5, cy=359.5)
        )

    def connect(self) -> None:
        pass

    def close(self) -> None:
        pass

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        simulation = self._config.simulation
        X = (simulation.X_base_camera or self._config.camera.X_base_camera).transform()
        image = render(
            self._world.visible(), self.intrinsics, X, Lighting(direction=simulation.light)
        )
        depth = image.depth
        if simulation.depth_noise:
            depth = with_stereo_noise(depth, image.color, self.intrinsics, self._rng)
        self._sequence += 1
        return RgbdFrame(
            color=image.color,
            depth=depth.astype(np.float32),
            intrinsics=self.intrinsics,
            captured_at=self._world.clock.now(),
            sequence=self._sequence,
            serial="simulated",
        )
