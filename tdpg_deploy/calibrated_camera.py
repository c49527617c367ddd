"""A camera whose frames are put right by its calibration, whichever camera it is."""

from __future__ import annotations

from dataclasses import replace

from tdpg_deploy.calibration_file import Calibration
from tdpg_deploy.hal import Camera, Intrinsics, RgbdFrame


class CalibratedCamera:
    """`hal.Camera`: depth by the calibration's model, and its lens where that was refined."""

    def __init__(self, camera: Camera, calibration: Calibration) -> None:
        self._camera = camera
        self._lens = calibration.camera.intrinsics() if calibration.camera.refined else None
        self._depth = None if calibration.depth is None else calibration.depth.model()

    @property
    def intrinsics(self) -> Intrinsics:
        return self._lens or self._camera.intrinsics

    def connect(self) -> None:
        self._camera.connect()

    def close(self) -> None:
        self._camera.close()

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        frame = self._camera.capture(deadline=deadline)
        depth = frame.depth if self._depth is None else self._depth.correct(frame.depth)
        # A lens of another size is not hidden here: it is refused before anything moves.
        return replace(frame, depth=depth, intrinsics=self._lens or frame.intrinsics)
