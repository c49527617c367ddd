"""The D435 driver keeps the promises of hal.py, on librealsense's pipeline."""

from __future__ import annotations

import pytest
from emulated_d435 import Scene, section
from hal_contract import CameraContract, CameraRig

from tdpg_deploy.cell import MachineClock
from tdpg_deploy.drivers.realsense import RealsenseCamera
from tdpg_deploy.emulators.realsense import EmulatedD435


class TestRealsenseCamera(CameraContract):
    @pytest.fixture(params=[(), ("spatial", "temporal")], ids=["plain", "filtered"])
    def rig(self, request: pytest.FixtureRequest) -> CameraRig:
        clock = MachineClock()
        source = EmulatedD435(Scene().frame)
        fields = section(filters=request.param)
        camera = RealsenseCamera(fields, clock=clock, source=source, warm_up=0.1)
        return CameraRig(camera=camera, clock=clock)
