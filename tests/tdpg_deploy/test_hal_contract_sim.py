"""The simulated devices keep the promises of hal.py."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hal_contract import (
    ArmContract,
    ArmRig,
    CameraContract,
    CameraRig,
    GripperContract,
    GripperRig,
)

from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.geometry import Transform, top_down
from tdpg_deploy.sim.arm import SimArm
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.camera import SimCamera
from tdpg_deploy.sim.gripper import SimGripper
from tdpg_deploy.sim.scenes import Scene, SceneObject
from tdpg_deploy.sim.world import World

CORNER = (0.68, 0.18, -0.12)  # m: out of the arm's way


def cell_of(model: str, carrier: str) -> CellConfig:
    config = load_cell(DEFAULT_CELL)
    arm = config.arm.model_copy(update={"model": model})
    simulation = config.simulation.model_copy(update={"carrier": carrier})
    return config.model_copy(update={"arm": arm, "simulation": simulation})


@pytest.fixture(params=["ur5 arm", "ur5e arm", "ur5 gantry"])
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    cube = SceneObject(
        shape=SHAPES["cube"],
        X_base_object=Transform.from_quaternion(CORNER, (0, 0, 0, 1)),
        rgb=(200, 60, 60),
        goal=False,
    )
    world = World(cell_of(*request.param.split()), Scene(objects=(cube,)), seed=0)
    yield world
    world.close()


class TestSimArm(ArmContract):
    @pytest.fixture
    def rig(self, world: World) -> ArmRig:
        gripper = SimGripper(world)
        gripper.activate()
        gripper.move(0.0, speed=0.15, force=20.0)  # floor_z is that of closed tips
        table_z = world.config.workspace.table_z
        return ArmRig(arm=SimArm(world), clock=world.clock, config=world.config, floor_z=table_z)


class TestSimGripper(GripperContract):
    @pytest.fixture
    def rig(self, world: World) -> GripperRig:
        def hold() -> float:
            """Bring the open pads down around the cube in the corner."""
            arm = SimArm(world)
            x, y, _ = CORNER
            for z in (0.10, 0.01):
                arm.move_linear(
                    top_down(x, y, world.config.workspace.table_z + z, 0.0),
                    speed=0.3,
                    acceleration=1.2,
                    deadline=20.0,
                )
            return 0.05

        return GripperRig(gripper=SimGripper(world), clock=world.clock, hold=hold)


class TestSimCamera(CameraContract):
    @pytest.fixture
    def rig(self, world: World) -> CameraRig:
        return CameraRig(camera=SimCamera(world, world.config), clock=world.clock)
