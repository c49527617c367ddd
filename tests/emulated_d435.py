"""A small scene before an emulated D435, for the tests of the camera driver."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from tdpg_deploy.cell import MachineClock
from tdpg_deploy.cell_config import CameraSection, Pose
from tdpg_deploy.drivers.realsense import RealsenseCamera
from tdpg_deploy.emulators.realsense import DepthCamera, EmulatedD435
from tdpg_deploy.hal import Intrinsics, RgbdFrame

SERIAL = "817612070123"
INTRINSICS = Intrinsics(
    width=640,
    height=480,
    fx=611.5,
    fy=610.25,
    cx=322.5,
    cy=238.75,
    distortion=(0.01, -0.02, 0.001, -0.002, 0.003),
)


class Scene:
    """What is before the lens: arrays that a test may change at any time."""

    def __init__(self, intrinsics: Intrinsics = INTRINSICS) -> None:
        self.intrinsics = intrinsics
        size = (intrinsics.height, intrinsics.width)
        rng = np.random.default_rng(7)
        self.color: npt.NDArray[np.uint8] = rng.integers(0, 256, (*size, 3)).astype(np.uint8)
        counts = rng.integers(300, 1200, size)
        self.depth = (counts * 0.001).astype(np.float32)
        self.depth[rng.random(size) < 0.05] = np.nan

    def frame(self) -> RgbdFrame:
        return RgbdFrame(
            color=self.color,
            depth=self.depth,
            intrinsics=self.intrinsics,
            captured_at=0.0,
            sequence=0,
            serial="",
        )


def section(**fields: Any) -> CameraSection:
    """A camera section for the emulated camera's 640 x 480 pixels."""
    return CameraSection(width=640, X_base_camera=Pose(position=(0, 0, 1)), **fields)


@contextmanager
def emulated(
    scene: Scene, depth_camera: DepthCamera | None = None, **fields: Any
) -> Iterator[tuple[RealsenseCamera, EmulatedD435]]:
    """A connected driver and the emulated camera that it is connected to."""
    source = EmulatedD435(scene.frame, serial=SERIAL, depth_camera=depth_camera)
    camera = RealsenseCamera(section(**fields), clock=MachineClock(), source=source, warm_up=0.0)
    try:
        camera.connect()
        yield camera, source
    finally:
        camera.close()
