from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from small_cells import CARRIERS, MOCK, TABLE, lying, pointing_down, running, touch, travel
from ur_analytic_ik import ur5

from tdpg_deploy.errors import ArmError, DeviceTimeout
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import ArmState, MotionEnd
from tdpg_deploy.sim.world import Where


@pytest.mark.parametrize("carrier", CARRIERS)
def test_a_linear_move_is_straight_and_in_time(carrier: str) -> None:
    with running(carrier) as (world, arm, _):
        start = arm.state().X_base_tool
        goal = pointing_down(0.6, 0.2, 0.25, 0.7)
        states: list[ArmState] = []
        began = world.clock.now()
        result = travel(arm, goal, states.append)
        assert result.end is MotionEnd.REACHED
        assert result.state.X_base_tool.distance(goal) == pytest.approx((0, 0), abs=1e-3)
        assert_allclose(result.state.qd, 0, atol=0.02)
        way = goal.translation - start.translation
        length = np.linalg.norm(way)
        for state in states:
            off = np.cross(state.X_base_tool.translation - start.translation, way) / length
            assert np.linalg.norm(off) < 2e-3
        assert_allclose(world.clock.now() - began, length / 0.5 + 0.5 / 2.0, atol=0.05)
        assert np.diff([state.stamp for state in states]).max() <= 1 / 20


@pytest.mark.parametrize("carrier", CARRIERS)
def test_joints_tell_where_the_tool_is(carrier: str) -> None:
    with running(carrier) as (_, arm, _):
        state = travel(arm, pointing_down(0.4, -0.1, 0.2, 0.3)).state
        flange = Transform.from_matrix(ur5.forward_kinematics(*state.q))
        tool = flange @ MOCK.arm.X_flange_tool.transform()
        assert tool.distance(state.X_base_tool) == pytest.approx((0, 0), abs=1e-5)


@pytest.mark.parametrize("carrier", CARRIERS)
def test_a_joint_move_ends_at_its_joints(carrier: str) -> None:
    with running(carrier) as (_, arm, _):
        q = travel(arm, pointing_down(0.5, 0.1, 0.25, 1.0)).state.q
        home = np.array(MOCK.arm.home)
        for goal in (home, q):
            result = arm.move_joints(goal, speed=1, acceleration=3, deadline=9)
            assert result.end is MotionEnd.REACHED
            assert_allclose(result.state.q, goal, atol=2e-3)


@pytest.mark.parametrize("carrier", CARRIERS)
def test_the_last_joint_goes_the_way_it_is_told(carrier: str) -> None:
    """A tool that takes the short way round would wind up by a turn each time."""
    home = np.array(MOCK.arm.home)
    with running(carrier) as (_, arm, _):
        for wrist in (3.0, -3.0) * 3:
            goal = np.array([*home[:5], wrist])
            result = arm.move_joints(goal, speed=3, acceleration=9, deadline=9)
            assert_allclose(result.state.q, goal, atol=2e-3)
            assert_allclose(arm.state().q, goal, atol=2e-3)


@pytest.mark.parametrize("carrier", CARRIERS)
def test_a_descent_onto_a_block_stops_on_force(carrier: str) -> None:
    with running(carrier, lying("cube")) as (world, arm, gripper):
        gripper.move(0, speed=0.15, force=20)
        travel(arm, pointing_down(0.5, 0, 0.15))
        states: list[ArmState] = []
        result = touch(arm, pointing_down(0.5, 0, 0.01), on_state=states.append)
        assert result.end is MotionEnd.CONTACT
        assert max(np.linalg.norm(state.force) for state in states) > 15  # whoever logs them sees
        assert_allclose(result.state.X_base_tool.translation[2], TABLE + 0.05, atol=0.003)
        assert np.abs(result.state.qd).max() < 0.05
        travel(arm, pointing_down(0.5, 0, 0.15))
        (cube,) = world.objects()
        assert cube.where is Where.WORKSPACE
        assert_allclose(cube.X_base_object.translation, [0.5, 0, TABLE + 0.025], atol=0.005)


@pytest.mark.parametrize("carrier", CARRIERS)
def test_a_push_moves_a_block(carrier: str) -> None:
    with running(carrier, lying("cube")) as (world, arm, gripper):
        gripper.move(0, speed=0.15, force=20)
        travel(arm, pointing_down(0.42, 0, 0.2))
        travel(arm, pointing_down(0.42, 0, 0.02))
        result = touch(arm, pointing_down(0.52, 0, 0.02), stop_force=50)
        assert result.end is MotionEnd.REACHED
        (cube,) = world.objects()
        # Closed fingers reach 14 mm ahead of the tool, and the cube 25 mm back from its centre.
        x, y, _ = cube.X_base_object.translation
        assert_allclose([x, y], [0.52 + 0.014 + 0.025, 0], atol=0.005)


@pytest.mark.parametrize("carrier", CARRIERS)
def test_out_of_reach_nothing_moves(carrier: str) -> None:
    with running(carrier) as (world, arm, _):
        before = world.steps
        with pytest.raises(ArmError, match="cannot reach"):
            travel(arm, pointing_down(1.1, 0, 0.2))
        with pytest.raises(ArmError, match="six angles"):
            arm.move_joints(np.full(6, np.nan), speed=1, acceleration=1, deadline=9)
        assert world.steps == before


def test_a_blocked_arm_says_so() -> None:
    with running("arm") as (_, arm, gripper):
        gripper.move(0, speed=0.15, force=20)
        travel(arm, pointing_down(0.5, 0, 0.05))
        with pytest.raises(ArmError, match="blocks the arm"):
            travel(arm, pointing_down(0.5, 0, -0.05))


def test_deadline_and_stop_halt_the_arm() -> None:
    with running("gantry") as (world, arm, _):
        began = world.clock.now()
        with pytest.raises(DeviceTimeout, match=r"within 0.3 s"):
            arm.move_linear(pointing_down(0.6, 0, 0.2), speed=0.2, acceleration=1, deadline=0.3)
        assert world.clock.now() - began < 0.35
        assert_allclose(arm.state().qd, 0, atol=0.02)

        with pytest.raises(ArmError, match="stopped"):
            travel(arm, pointing_down(0.6, 0, 0.2), lambda state: arm.stop())
        assert_allclose(arm.state().qd, 0, atol=0.02)
        travel(arm, pointing_down(0.6, 0, 0.2))  # and goes on when asked to
