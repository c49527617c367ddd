"""Cells, objects and poses that the tests of the simulated cell share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from scipy.spatial.transform import Rotation

from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import MotionResult, OnArmState
from tdpg_deploy.sim.arm import SimArm
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.gripper import SimGripper
from tdpg_deploy.sim.scenes import Scene, SceneObject, random_scene
from tdpg_deploy.sim.world import World
from tdpg_deploy.workspace import workspace_of

CARRIERS = ("gantry", "arm")
MOCK = load_cell(DEFAULT_CELL)
WORKSPACE = workspace_of(MOCK)
TABLE = WORKSPACE.table_z


def cell(carrier: str, model: str = "ur5") -> CellConfig:
    arm = MOCK.arm.model_copy(update={"model": model})
    simulation = MOCK.simulation.model_copy(update={"carrier": carrier})
    return MOCK.model_copy(update={"arm": arm, "simulation": simulation})


def pointing_down(x: float, y: float, height: float, yaw: float = 0.0) -> Transform:
    """A pose of the tool; height above the table."""
    turn = Rotation.from_euler("z", yaw) * Rotation.from_euler("x", np.pi)
    return Transform(turn, np.array([x, y, TABLE + height]))


def lying(name: str, x: float = 0.5, y: float = 0.0, *, on: float = 0.0) -> SceneObject:
    """A block as it was built, just above the table or above a support of height `on`."""
    shape = SHAPES[name]
    z = TABLE + on - shape.vertices[:, 2].min() + 0.0005
    X_base_object = Transform(Rotation.identity(), np.array([x, y, z]))
    return SceneObject(shape=shape, X_base_object=X_base_object, rgb=(200, 40, 40))


def heap(n: int, seed: int) -> Scene:
    return random_scene(n, WORKSPACE, np.random.default_rng(seed))


@contextmanager
def running(
    carrier: str, *objects: SceneObject, model: str = "ur5"
) -> Iterator[tuple[World, SimArm, SimGripper]]:
    """A cell with these objects, the gripper activated."""
    world = World(cell(carrier, model), Scene(objects=objects), seed=0)
    gripper = SimGripper(world)
    gripper.activate()
    try:
        yield world, SimArm(world), gripper
    finally:
        world.close()


def travel(arm: SimArm, X_base_tool: Transform, on_state: OnArmState | None = None) -> MotionResult:
    """Through free space."""
    return arm.move_linear(
        X_base_tool, speed=0.5, acceleration=2.0, deadline=9.0, on_state=on_state
    )


def touch(
    arm: SimArm,
    X_base_tool: Transform,
    stop_force: float = 15.0,
    on_state: OnArmState | None = None,
) -> MotionResult:
    """Until there, or until something is in the way."""
    arm.zero_force()
    return arm.move_linear(
        X_base_tool,
        speed=0.15,
        acceleration=1.2,
        deadline=9.0,
        stop_force=stop_force,
        on_state=on_state,
    )
