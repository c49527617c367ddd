"""The UR driver keeps the promises of hal.py, over ur_rtde and the wire, on both generations."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hal_contract import ArmContract, ArmRig
from ur_rig import arm_section, emulated_controller, new_host

from tdpg_deploy.cell import MachineClock
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.drivers.ur5 import UrArm


@pytest.fixture(scope="module", params=["cb3 in the simulated world", "e-series"])
def host(request: pytest.FixtureRequest) -> Iterator[str]:
    """In real time: the contract looks at speeds and rates, and this process must keep up."""
    address = new_host()
    generation, *world = request.param.split(maxsplit=1)
    switches = {"physics": True} if world else {}
    with emulated_controller(address, generation=generation, **switches):
        yield address


@pytest.mark.slow
@pytest.mark.real_time
class TestUrArm(ArmContract):
    @pytest.fixture
    def rig(self, host: str) -> ArmRig:
        clock = MachineClock()
        config = load_cell(DEFAULT_CELL)
        arm = UrArm(arm_section(host), clock=clock)
        return ArmRig(arm=arm, clock=clock, config=config, floor_z=config.workspace.table_z)
