"""The 2F-85 driver keeps the promises of hal.py on every wire."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hal_contract import GripperContract, GripperRig
from robotiq_on_wires import WIRES, bench_on

HELD = 0.032  # m


class TestRobotiqGripper(GripperContract):
    @pytest.fixture(params=WIRES)
    def rig(self, request: pytest.FixtureRequest) -> Iterator[GripperRig]:
        with bench_on(request.param) as bench:

            def hold() -> float:
                bench.span = (HELD, 0.085)
                return HELD

            yield GripperRig(gripper=bench.gripper, clock=bench.clock, hold=hold, exact=3e-4)
