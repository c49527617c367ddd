from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from small_cells import CARRIERS, MOCK, TABLE, WORKSPACE, cell, heap, lying, pointing_down, running

from tdpg_deploy.errors import SceneError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Clock
from tdpg_deploy.sim.arm import SimArm
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.gripper import SimGripper
from tdpg_deploy.sim.physics import GRAVITY
from tdpg_deploy.sim.pieces import BIN, ROBOT
from tdpg_deploy.sim.pieces import TABLE as TABLE_OWNER
from tdpg_deploy.sim.scenes import Scene, SceneObject
from tdpg_deploy.sim.world import Where, World


def fingerprint(carrier: str) -> str:
    """Every bit of what happens to a heap that the gripper reaches into."""
    world = World(cell(carrier), heap(8, 5), seed=5)
    arm, gripper = SimArm(world), SimGripper(world)
    gripper.activate()
    x, y, _ = world.objects()[0].X_base_object.translation
    arm.move_linear(pointing_down(x, y, 0.2, 0.3), speed=1, acceleration=5, deadline=9)
    arm.move_linear(
        pointing_down(x, y, 0.01, 0.3), speed=0.25, acceleration=5, deadline=9, stop_force=15
    )
    gripper.move(0, speed=0.15, force=20)
    arm.move_linear(pointing_down(x, y, 0.2, 0.3), speed=1, acceleration=5, deadline=9)
    state = arm.state()
    numbers = [state.q, state.force, np.array([world.clock.now(), gripper.state().width])]
    for item in world.objects():
        numbers += [item.X_base_object.translation, item.X_base_object.rotation.as_quat()]
    world.close()
    return hashlib.sha256(np.concatenate(numbers).tobytes()).hexdigest()


@pytest.mark.parametrize("carrier", CARRIERS)
def test_same_seed_same_outcome_to_the_bit(carrier: str) -> None:
    assert fingerprint(carrier) == fingerprint(carrier)


@pytest.mark.slow
def test_same_outcome_in_another_process() -> None:
    code = f"from test_sim_world import fingerprint; print(fingerprint({CARRIERS[1]!r}))"
    other = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
    )
    assert other.stdout.split()[-1] == fingerprint(CARRIERS[1])


@pytest.mark.parametrize(("n", "seed"), [(1, 0), (10, 1), (10, 2), (30, 3), (30, 4)])
def test_heaps_settle_inside_the_workspace(n: int, seed: int) -> None:
    world = World(cell("gantry"), heap(n, seed), seed=seed)
    before = world.objects()
    assert [state.index for state in before] == list(range(n))
    assert all(state.where is Where.WORKSPACE for state in before)
    world.clock.sleep(0.5)
    for a, b in zip(before, world.objects(), strict=True):
        assert a.X_base_object.distance(b.X_base_object)[0] < 0.001
    for state in before:  # nothing has sunk into the table
        assert (state.X_base_object @ state.shape.vertices)[:, 2].min() > TABLE - 0.002
    world.close()


# A bar that stands askew over the border and topples outwards, off the square.
TOPPLING = SceneObject(
    shape=SHAPES["bar"],
    X_base_object=Transform(
        Rotation.from_euler("y", -60, degrees=True),
        np.array([WORKSPACE.x_max - 0.001, 0.0, TABLE + 0.06]),
    ),
    rgb=(0, 0, 0),
)


def test_what_falls_beside_the_workspace_is_dropped_again() -> None:
    world = World(cell("gantry"), Scene(objects=(TOPPLING,)), seed=0)
    (state,) = world.objects()
    assert state.where is Where.WORKSPACE
    assert state.X_base_object.distance(TOPPLING.X_base_object)[0] > 0.05
    world.close()


def test_objects_that_cannot_stay_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tdpg_deploy.sim.world.SETTLE_DROPS", 0)
    with pytest.raises(SceneError, match=r"1 of 1 objects still fall out .* after 0 drops"):
        World(cell("gantry"), Scene(objects=(TOPPLING,)), seed=0)


def test_a_scene_outside_of_the_workspace_is_refused() -> None:
    with pytest.raises(SceneError, match=r"object\[0\].position = \(0.900"):
        World(cell("gantry"), Scene(objects=(lying("cube", 0.9),)), seed=0)


@pytest.mark.parametrize("name", SHAPES)
def test_blocks_rest_on_the_table_not_above_or_in_it(name: str) -> None:
    with running("gantry", lying(name)) as (world, _, _):
        (state,) = world.objects()
        lowest = (state.X_base_object @ state.shape.vertices)[:, 2].min()
        assert_allclose(lowest, TABLE, atol=3e-4)


def test_a_snapshot_builds_the_same_again() -> None:
    world = World(cell("gantry"), heap(10, 1), seed=1)
    again = World(cell("gantry"), world.scene(), seed=1)
    for a, b in zip(world.objects(), again.objects(), strict=True):
        assert a.shape is b.shape
        assert a.X_base_object.distance(b.X_base_object)[0] < 3e-3
    world.close()
    again.close()


def test_an_empty_table() -> None:
    with running("gantry") as (world, _, _):
        assert world.objects() == ()
        assert world.scene().objects == ()
        assert {piece.owner for piece in world.visible()} == {TABLE_OWNER, ROBOT, BIN}


def test_time_only_grows_with_steps() -> None:
    with running("gantry") as (world, _, _):
        clock: Clock = world.clock
        before = clock.now()
        assert clock.now() == before
        clock.sleep(0.5)
        assert_allclose(clock.now() - before, 0.5, atol=1 / 240)


def test_visible_pieces_are_where_the_physics_has_them() -> None:
    with running("arm", lying("arch")) as (world, arm, _):
        pieces = world.visible()
        arch = [piece for piece in pieces if piece.owner == 0]
        assert len(arch) == len(SHAPES["arch"].pieces)
        (state,) = world.objects()
        assert all(p.X_base_piece.distance(state.X_base_object) == (0, 0) for p in arch)
        table = pieces[0]
        assert (table.X_base_piece @ table.piece.vertices)[:, 2].max() == pytest.approx(TABLE)
        robot = [p.X_base_piece @ p.piece.vertices for p in pieces if p.owner == ROBOT]
        tip = arm.state().X_base_tool.translation
        # Open fingers stand 14 mm behind the tool, which is at the tips of closed ones.
        lowest = min(v[:, 2].min() for v in robot if np.linalg.norm(v.mean(axis=0) - tip) < 0.1)
        assert_allclose(lowest - tip[2], 0.014, atol=0.001)


def test_at_home_the_robot_hides_nothing_from_the_camera() -> None:
    """Each piece of it lies beyond some face of the hull of camera and workspace."""
    corners = [
        (x, y, z)
        for x in (WORKSPACE.x_min, WORKSPACE.x_max)
        for y in (WORKSPACE.y_min, WORKSPACE.y_max)
        for z in (TABLE, TABLE + 0.15)
    ]
    view = ConvexHull([MOCK.X_base_camera.translation, *corners]).equations
    with running("arm") as (world, _, _):
        moving = [p for p in world.visible() if p.owner == ROBOT][1:]  # the first is the plinth
        for p in moving:
            vertices = p.X_base_piece @ p.piece.vertices
            beyond = vertices @ view[:, :3].T + view[:, 3]
            assert beyond.min(axis=0).max() > 0.02


def test_home_is_above_the_bin() -> None:
    with running("arm") as (_, arm, _):
        tool = arm.state().X_base_tool
        assert_allclose(tool.translation[:2], MOCK.bin.position[:2], atol=0.001)
        assert tool.translation[2] > MOCK.bin.position[2]
        assert_allclose(tool.rotation.as_matrix()[:, 2], [0, 0, -1], atol=1e-3)


@pytest.mark.parametrize("carrier", CARRIERS)
def test_the_world_presses_on_the_tool_with_the_weight_it_carries(carrier: str) -> None:
    with running(carrier, lying("bar")) as (world, arm, gripper):
        arm.move_linear(pointing_down(0.5, 0, 0.2, np.pi / 2), speed=1, acceleration=5, deadline=9)
        arm.zero_force()
        arm.move_linear(
            pointing_down(0.5, 0, 0.012, np.pi / 2), speed=0.2, acceleration=2, deadline=9
        )
        gripper.move(0, speed=0.1, force=20)
        arm.move_linear(
            pointing_down(0.5, 0, 0.2, np.pi / 2), speed=0.5, acceleration=1, deadline=9
        )
        forces = []
        for _ in range(120):
            world.step()
            forces.append(arm.state().force)
        weight = 650 * 0.1 * 0.05 * 0.05 * GRAVITY  # of a beech bar
        assert_allclose(np.mean(forces, axis=0), [0, 0, -weight], atol=0.15)


def test_what_is_pushed_off_the_workspace_is_reported() -> None:
    at_border = lying("cube", WORKSPACE.x_max - 0.03)
    with running("gantry", at_border, lying("slab", 0.4)) as (world, arm, gripper):
        gripper.move(0, speed=0.15, force=20)
        start = WORKSPACE.x_max - 0.12
        for pose in (pointing_down(start, 0, 0.2), pointing_down(start, 0, 0.015)):
            arm.move_linear(pose, speed=0.5, acceleration=5, deadline=9)
        arm.move_linear(
            pointing_down(start + 0.1, 0, 0.015),
            speed=0.15, acceleration=2, deadline=9, stop_force=50,
        )  # fmt: skip
        world.clock.sleep(0.5)
        assert [state.where for state in world.objects()] == [Where.OUTSIDE, Where.WORKSPACE]
        assert [item.shape.name for item in world.scene().objects] == ["slab"]


def test_a_closed_world_can_be_closed_again() -> None:
    world = World(cell("gantry"), Scene(objects=()), seed=0)
    world.close()
    world.close()
