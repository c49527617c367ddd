"""Kinematics against the closed form of somebody else, ur_analytic_ik."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ur_analytic_ik import ur5

from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.kinematics import (
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


def random_joints(n: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (n, 6))


def test_forward_agrees_with_reference() -> None:
    q = random_joints(300)
    reference = np.array([ur5.forward_kinematics(*row) for row in q])
    np.testing.assert_allclose(forward_batch(q), reference, atol=1e-12)


def test_inverse_finds_as_many_branches_as_the_reference_and_all_lead_back() -> None:
    poses = forward_batch(random_joints(300, seed=1))
    for pose, branches in zip(poses, inverse_batch(poses), strict=True):
        reached = branches[np.isfinite(branches).all(axis=1)]
        assert len(reached) == len(ur5.inverse_kinematics(np.ascontiguousarray(pose)))
        np.testing.assert_allclose(
            forward_batch(reached), np.broadcast_to(pose, (len(reached), 4, 4)), atol=1e-9
        )


@given(joints)
def test_some_branch_is_where_the_arm_was(q: Array) -> None:
    assume(abs(np.sin(q[4])) > 1e-3)  # else wrist 3 is free, and 0 may be out of reach
    X_base_tool = forward(q, X_FLANGE_TOOL)
    found = nearest(inverse(X_base_tool, X_FLANGE_TOOL), q, TWO_TURNS)
    assert found is not None
    distance, angle = forward(found, X_FLANGE_TOOL).distance(X_base_tool)
    assert distance < 1e-6
    assert angle < 1e-6


@pytest.mark.parametrize("base", [0.0, 90.0, 180.0])
def test_wrist_three_at_zero_keeps_all_branches(base: float) -> None:
    q = np.deg2rad([base, -110.0, 100.0, -80.0, -90.0, 0.0])
    branches = inverse(forward(q, X_FLANGE_TOOL), X_FLANGE_TOOL)
    assert len(branches) == 8
    found = nearest(branches, q, TWO_TURNS)
    assert found is not None
    np.testing.assert_allclose(found, q, atol=1e-9)
    assert np.allclose(np.sort(np.abs(branches).max(axis=1)) <= np.pi + 1e-9, True)


def test_out_of_reach_has_no_branch() -> None:
    X_base_tool = Transform.from_quaternion((1.5, 0.0, 0.3), (1, 0, 0, 0))
    assert inverse(X_base_tool, X_FLANGE_TOOL).shape == (0, 6)


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


def test_branch_of_tells_the_branches_apart() -> None:
    q = np.deg2rad([170.0, -100.0, 110.0, -100.0, -90.0, 20.0])
    branches = inverse_batch(forward_batch(q))
    assert [branch_of(branch) for branch in branches] == list(range(8))


def test_elbow_height_is_that_of_the_third_frame() -> None:
    """The elbow's axis is where wrist and forearm would be if they had no length: compare with
    the height that turning the elbow leaves alone."""
    q = np.deg2rad([20.0, -70.0, 40.0, 10.0, 50.0, 0.0])
    for lift in (-120.0, -90.0, -10.0):
        q[1] = np.deg2rad(lift)
        straight_up = 0.089159 + 0.425 * np.cos(np.deg2rad(lift + 90.0))
        assert elbow_height(q) == pytest.approx(straight_up)
