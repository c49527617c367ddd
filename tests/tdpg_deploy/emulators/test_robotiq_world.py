"""The emulated 2F-85 with the physics behind it: it holds what lies between its fingers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.drivers.robotiq_registers import Contact, Status, parse_status
from tdpg_deploy.emulators.robotiq import RobotiqModel
from tdpg_deploy.emulators.robotiq_world import WorldJaws
from tdpg_deploy.geometry import Transform, top_down
from tdpg_deploy.sim.arm import SimArm
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.scenes import Scene, SceneObject
from tdpg_deploy.sim.world import World

CUBE = 0.05  # m
PLACE = (0.5, 0.0)


class Gripper:
    """An emulated gripper in a world that the test steps."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.jaws = WorldJaws(world)
        self.model = RobotiqModel(self.jaws, world.clock.now)

    def status(self) -> Status:
        return parse_status(self.model.read(2000, 3))

    def let_pass(self, seconds: float) -> Status:
        end = self.world.clock.now() + seconds
        while self.world.clock.now() < end:
            self.jaws.advance()
            self.world.step()
            self.model.advance()
        return self.status()

    def command(self, *words: int) -> None:
        self.model.write(1000, words)


@pytest.fixture
def gripper() -> Iterator[Gripper]:
    config = load_cell(DEFAULT_CELL)
    simulation = config.simulation.model_copy(update={"carrier": "gantry"})
    config = config.model_copy(update={"simulation": simulation})
    cube = SceneObject(
        shape=SHAPES["cube"],
        X_base_object=Transform.from_quaternion(
            (*PLACE, config.workspace.table_z + CUBE / 2), (0, 0, 0, 1)
        ),
        rgb=(200, 60, 60),
        goal=False,
    )
    world = World(config, Scene(objects=(cube,)), seed=0)
    gripper = Gripper(world)
    gripper.command(0x0100)
    assert gripper.let_pass(3.0).is_ready
    yield gripper
    world.close()


def test_it_closes_on_nothing_and_on_a_cube(gripper: Gripper) -> None:
    gripper.command(0x0900, 255, 0xFFFF)
    closed = gripper.let_pass(1.5)
    assert closed.contact is Contact.AT_REQUEST
    assert closed.position == pytest.approx(228, abs=3)
    gripper.command(0x0900, 0, 0xFFFF)
    assert gripper.let_pass(1.5).position == pytest.approx(3, abs=3)
    table_z = gripper.world.config.workspace.table_z
    for height in (0.10, 0.01):
        SimArm(gripper.world).move_linear(
            top_down(*PLACE, table_z + height, 0.0), speed=0.3, acceleration=1.2, deadline=20.0
        )
    gripper.command(0x0900, 255, 0xFF00)
    held = gripper.let_pass(1.5)
    assert held.contact is Contact.WHILE_CLOSING
    assert gripper.jaws.state().width == pytest.approx(CUBE, abs=0.002)


def test_it_stops_where_it_is_told_to(gripper: Gripper) -> None:
    gripper.command(0x0900, 255, 0x0000)
    assert gripper.let_pass(0.5).contact is Contact.MOVING
    gripper.command(0x0100)
    gripper.let_pass(0.1)
    width = gripper.jaws.state().width
    assert 0.06 < width < 0.084
    gripper.let_pass(0.5)
    assert gripper.jaws.state().width == pytest.approx(width, abs=0.001)
