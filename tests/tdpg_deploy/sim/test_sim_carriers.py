from __future__ import annotations

import numpy as np
import pybullet
import pytest
from numpy.testing import assert_allclose
from small_cells import MOCK, pointing_down, running
from ur_analytic_ik import ur5, ur5e

from tdpg_deploy.errors import ArmError
from tdpg_deploy.kinematics import MODELS, UR5
from tdpg_deploy.sim.carriers import Gantry, SerialArm, follow, line

HOME = np.array(MOCK.arm.home)
WAY = np.arange(201) / 200
X_flange_tool = MOCK.arm.X_flange_tool.transform()


@pytest.mark.parametrize("model", MODELS)
def test_the_simulated_arm_has_its_models_kinematics(model: str) -> None:
    """Where the physics puts the palm, against an independent library."""
    reference = {"ur5": ur5, "ur5e": ur5e}[model]
    rng = np.random.default_rng(0)
    with running("arm", model=model) as (world, _, _):
        robot = world.robot
        palm = len(robot.carrier.links)
        for q in rng.uniform(-np.pi, np.pi, (50, 6)):
            robot.place(q, 0.0)
            state = pybullet.getLinkState(
                robot.body, palm, computeForwardKinematics=True, physicsClientId=world.client
            )
            flange = reference.forward_kinematics(*q)
            assert_allclose(state[4], flange[:3, 3], atol=1e-6)
            turn = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
            assert_allclose(turn, flange[:3, :3], atol=1e-6)


def test_the_gantry_holds_the_flange_where_the_arm_would() -> None:
    gantry = Gantry(UR5)
    with running("gantry") as (world, _, _):
        for yaw in np.linspace(-3, 3, 7):
            X_base_flange = pointing_down(0.4, -0.1, 0.3, yaw) @ X_flange_tool.inverse()
            joints = gantry.along_line(gantry.at(HOME), X_base_flange, np.array([1.0]))[0]
            assert gantry.flange(joints).distance(X_base_flange) == pytest.approx((0, 0), abs=1e-9)
            world.robot.place(joints, 0.0)
            position, turn = pybullet.getLinkState(
                world.robot.body, 4, computeForwardKinematics=True, physicsClientId=world.client
            )[4:6]
            assert_allclose(position, X_base_flange.translation, atol=1e-6)
            dot = np.dot(turn, X_base_flange.rotation.as_quat())
            assert_allclose(abs(dot), 1, atol=1e-9)


def test_a_line_is_straight_and_turns_evenly() -> None:
    start, end = pointing_down(0.3, -0.2, 0.2, 0.0), pointing_down(0.6, 0.2, 0.1, 1.0)
    poses = line(start, end, np.arange(5) / 4)
    assert_allclose(poses[2, :3, 3], (start.translation + end.translation) / 2)
    assert_allclose(poses[1], pointing_down(0.375, -0.1, 0.175, 0.25).as_matrix(), atol=1e-12)


def test_following_a_line_solves_the_inverse_kinematics() -> None:
    start, end = SerialArm(UR5).flange(HOME), pointing_down(0.6, 0.2, 0.4, 0.5)
    poses = line(start, end, WAY)
    for pose, q in zip(poses, follow(UR5, poses, HOME), strict=True):
        assert_allclose(ur5.forward_kinematics(*q), pose, atol=1e-6)


def test_out_of_reach() -> None:
    beyond = pointing_down(1.2, 0.0, 0.4)
    with pytest.raises(ArmError, match="cannot reach"):
        follow(UR5, line(SerialArm(UR5).flange(HOME), beyond, WAY), HOME)


def test_a_way_past_the_shoulder_is_refused() -> None:
    """Through the column over the base, where the shoulder would have to jump."""
    start = pointing_down(0.0, -0.4, 0.4) @ X_flange_tool.inverse()
    end = pointing_down(0.0, 0.4, 0.4) @ X_flange_tool.inverse()
    near = follow(UR5, start.as_matrix()[None], HOME, max_step=np.inf)[0]
    with pytest.raises(ArmError):
        follow(UR5, line(start, end, WAY), near)


def test_the_gantry_refuses_a_tilted_tool() -> None:
    with pytest.raises(ArmError, match=r"tilts it by 90.0 deg"):
        Gantry(UR5).at(np.zeros(6))
