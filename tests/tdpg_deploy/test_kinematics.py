"""Kinematics of both arms against the closed form of somebody else, ur_analytic_ik."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ur_analytic_ik import ur5, ur5e

from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.kinematics import (
    UR5,
    UR5E,
    DhParameters,
    branch_of,
    elbow_height,
    forward,
    forward_batch,
    inverse,
    inverse_batch,
    nearest,
)

X_FLANGE_TOOL = Transform.from_quaternion((0.01, -0.02, 0.163), (0.1, 0.2, 0.3, 0.9))
TWO_TURNS = (-2 * np.pi, 2 * np.pi)

angles = st.floats(-3.1, 3.1)
joints = st.tuples(angles, angles, angles, angles, angles, angles).map(np.array)
arms = st.sampled_from([UR5, UR5E])
REFERENCES = {UR5: ur5, UR5E: ur5e}


def random_joints(n: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (n, 6))


@pytest.fixture(params=[UR5, UR5E], ids=["ur5", "ur5e"])
def dh(request: pytest.FixtureRequest) -> DhParameters:
    arm: DhParameters = request.param
    return arm


def test_forward_agrees_with_reference(dh: DhParameters) -> None:
    q = random_joints(300)
    reference = np.array([REFERENCES[dh].forward_kinematics(*row) for row in q])
    np.testing.assert_allclose(forward_batch(dh, q), reference, atol=1e-12)


def test_inverse_finds_the_branches_of_the_reference_and_all_lead_back(dh: DhParameters) -> None:
    poses = forward_batch(dh, random_joints(300, seed=1))
    for pose, branches in zip(poses, inverse_batch(dh, poses), strict=True):
        reached = branches[np.isfinite(branches).all(axis=1)]
        theirs = np.array(REFERENCES[dh].inverse_kinematics(np.ascontiguousarray(pose)))
        apart = np.abs(np.angle(np.exp(1j * (reached[:, None] - theirs)))).max(axis=-1)
        assert (apart.min(axis=0) < 1e-6).all()
        assert (apart.min(axis=1) < 1e-6).all()
        np.testing.assert_allclose(
            forward_batch(dh, reached), np.broadcast_to(pose, (len(reached), 4, 4)), atol=1e-9
        )


@given(arms, joints)
def test_some_branch_is_where_the_arm_was(dh: DhParameters, q: Array) -> None:
    assume(abs(np.sin(q[4])) > 1e-3)  # else wrist 3 is free, and 0 may be out of reach
    X_base_tool = forward(dh, q, X_FLANGE_TOOL)
    found = nearest(inverse(dh, X_base_tool, X_FLANGE_TOOL), q, TWO_TURNS)
    assert found is not None
    distance, angle = forward(dh, found, X_FLANGE_TOOL).distance(X_base_tool)
    assert distance < 1e-6
    assert angle < 1e-6


@pytest.mark.parametrize("base", [0.0, 90.0, 180.0])
def test_wrist_three_at_zero_keeps_all_branches(dh: DhParameters, base: float) -> None:
    q = np.deg2rad([base, -110.0, 100.0, -80.0, -90.0, 0.0])
    branches = inverse(dh, forward(dh, q, X_FLANGE_TOOL), X_FLANGE_TOOL)
    assert len(branches) == 8
    found = nearest(branches, q, TWO_TURNS)
    assert found is not None
    np.testing.assert_allclose(found, q, atol=1e-9)
    assert np.allclose(np.sort(np.abs(branches).max(axis=1)) <= np.pi + 1e-9, True)


def test_out_of_reach_has_no_branch(dh: DhParameters) -> None:
    X_base_tool = Transform.from_quaternion((1.5, 0.0, 0.3), (1, 0, 0, 0))
    assert inverse(dh, X_base_tool, X_FLANGE_TOOL).shape == (0, 6)


def test_nearest_unwinds_whole_turns_within_the_range() -> None:
    branch = np.array([[-3.0, 0, 0, 0, 0, 0.0]])
    near = np.array([3.0, 0, 0, 0, 0, 0.0])
    unwound = nearest(branch, near, TWO_TURNS)
    assert unwound is not None
    assert unwound[0] == pytest.approx(2 * np.pi - 3.0)
    clipped = nearest(branch, near, (-3.1, 3.1))
    assert clipped is not None
    assert clipped[0] == pytest.approx(-3.0)
    assert nearest(branch, near, (-1.0, 1.0)) is None
    assert nearest(np.full((1, 6), np.nan), near, TWO_TURNS) is None


def test_branch_of_tells_the_branches_apart(dh: DhParameters) -> None:
    q = np.deg2rad([170.0, -100.0, 110.0, -100.0, -90.0, 20.0])
    branches = inverse_batch(dh, forward_batch(dh, q))
    assert [branch_of(dh, branch) for branch in branches] == list(range(8))


@pytest.mark.parametrize(("arm", "shoulder"), [(UR5, 0.089159), (UR5E, 0.1625)])
def test_elbow_height_is_that_of_the_third_frame(arm: DhParameters, shoulder: float) -> None:
    """The elbow's axis is where wrist and forearm would be if they had no length: compare with
    the height that turning the elbow leaves alone."""
    q = np.deg2rad([20.0, -70.0, 40.0, 10.0, 50.0, 0.0])
    for lift in (-120.0, -90.0, -10.0):
        q[1] = np.deg2rad(lift)
        straight_up = shoulder + 0.425 * np.cos(np.deg2rad(lift + 90.0))
        assert elbow_height(arm, q) == pytest.approx(straight_up)
