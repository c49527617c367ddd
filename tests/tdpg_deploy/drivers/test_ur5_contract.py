"""The UR driver keeps the promises of hal.py, over ur_rtde and the wire, on both arms."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hal_contract import ArmContract, ArmRig
from ur_rig import arm_section, emulated_controller, new_host

from tdpg_deploy.cell import MachineClock
from tdpg_deploy.cell_config import DEFAULT_CELL, ArmSection, load_cell
from tdpg_deploy.drivers.ur5 import UrArm


@pytest.fixture(scope="module", params=["ur5 in the simulated world", "ur5e"])
def section(request: pytest.FixtureRequest) -> Iterator[ArmSection]:
    """In real time: the contract looks at speeds and rates, and this process must keep up."""
    model, *world = request.param.split(maxsplit=1)
    section = arm_section(new_host(), model)
    switches = {"physics": True} if world else {}
    with emulated_controller(section.host, model=model, **switches):
        yield section


@pytest.mark.slow
@pytest.mark.real_time
class TestUrArm(ArmContract):
    @pytest.fixture
    def rig(self, section: ArmSection) -> ArmRig:
        clock = MachineClock()
        config = load_cell(DEFAULT_CELL).model_copy(update={"arm": section})
        arm = UrArm(section, clock=clock)
        return ArmRig(arm=arm, clock=clock, config=config, floor_z=config.workspace.table_z)
