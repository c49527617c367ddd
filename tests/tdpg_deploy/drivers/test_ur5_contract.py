"""The UR driver keeps the promises of hal.py, over ur_rtde and the wire, on both generations."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hal_contract import ArmContract, ArmRig
from ur_rig import PacedClock, arm_section, emulated_controller, new_host

from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.drivers.ur5 import UrArm

PACES = {"cb3 physics": 1.0, "e-series": 3.0}


@pytest.fixture(scope="module", params=PACES)
def controller(request: pytest.FixtureRequest) -> Iterator[tuple[str, float]]:
    host, pace = new_host(), PACES[request.param]
    generation, *physics = request.param.split()
    switches = dict.fromkeys(physics, True)
    with emulated_controller(host, generation=generation, pace=pace, **switches):
        yield host, pace


@pytest.mark.slow
class TestUrArm(ArmContract):
    @pytest.fixture
    def rig(self, controller: tuple[str, float]) -> ArmRig:
        host, pace = controller
        clock = PacedClock(pace)
        config = load_cell(DEFAULT_CELL)
        arm = UrArm(arm_section(host), clock=clock)
        return ArmRig(arm=arm, clock=clock, config=config, floor_z=config.workspace.table_z)
