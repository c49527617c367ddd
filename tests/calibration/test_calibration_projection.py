"""The measurement model against OpenCV's projection and against differences."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calibration.closed_form import board_pose
from calibration.projection import PARAMETERS, Estimate, Observations, linearise, project
from calibration.synthetic import D435_720P, Truth, make_truth, observe
from calibration.target import DEFAULT_TARGET
from calibration.views import Mounting, View
from tdpg_deploy.geometry import Array, Transform

CORNERS = DEFAULT_TARGET.corners()


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(*[st.floats(-0.3, 0.3)] * 2, *[st.floats(-0.01, 0.01)] * 2, st.floats(-0.1, 0.1)),
    st.integers(0, 1000),
)
def test_projection_is_opencvs(distortion: tuple[float, ...], seed: int) -> None:
    k1, k2, p1, p2, k3 = distortion
    lens = replace(D435_720P, distortion=(k1, k2, p1, p2, k3))
    rng = np.random.default_rng(seed)
    p_camera = np.column_stack([rng.uniform(-0.4, 0.4, (20, 2)), rng.uniform(0.5, 1.5, 20)])
    expected, _ = cv2.projectPoints(
        p_camera, np.zeros(3), np.zeros(3), lens.as_matrix(), np.array(distortion)
    )
    np.testing.assert_allclose(project(p_camera, lens)[0], expected.reshape(-1, 2), atol=1e-6)


@pytest.mark.parametrize("mounting", Mounting)
def test_derivatives_match_differences(mounting: Mounting) -> None:
    rng = np.random.default_rng(3)
    truth = make_truth(
        mounting, CORNERS, rng, replace(D435_720P, distortion=(0.1, -0.05, 1e-3, -1e-3, 0.01))
    )
    views = observe(truth, 4, rng)
    estimate = Estimate(
        X_parent_camera=truth.X_parent_camera,
        X_parent_board=truth.X_parent_board,
        intrinsics=truth.intrinsics,
        scale=1.01,
    )
    seen = Observations.of(views, CORNERS, mounting)
    found = linearise(estimate, seen)
    h = 1e-6
    for column, step in enumerate(h * np.eye(PARAMETERS)):
        up = linearise(estimate.moved(step), seen).residuals
        down = linearise(estimate.moved(-step), seen).residuals
        difference = (up - down) / (2 * h)
        np.testing.assert_allclose(found.jacobian[..., column], difference, atol=1e-3, rtol=1e-5)

    def with_arm_error(step: Array) -> Array:
        error = Transform(Rotation.from_rotvec(step[:3]), step[3:])
        moved = [replace(view, X_base_tool=view.X_base_tool @ error) for view in views]
        return linearise(estimate, Observations.of(moved, CORNERS, mounting)).residuals

    for column, step in enumerate(h * np.eye(6)):
        difference = (with_arm_error(step) - with_arm_error(-step)) / (2 * h)
        np.testing.assert_allclose(
            found.pose_jacobian[..., column], difference, atol=1e-3, rtol=1e-5
        )


def test_residuals_vanish_at_the_truth_and_where_nothing_was_seen() -> None:
    rng = np.random.default_rng(0)
    truth = make_truth(Mounting.EYE_TO_HAND, CORNERS, rng)
    views = observe(truth, 5, rng, pixel_noise=0)
    exact = [replace(view, X_base_tool=exact_pose(truth, view)) for view in views]
    exact[0] = replace(exact[0], ids=exact[0].ids[:10], corners=exact[0].corners[:10])
    estimate = Estimate(
        X_parent_camera=truth.X_parent_camera,
        X_parent_board=truth.X_parent_board,
        intrinsics=truth.intrinsics,
    )
    found = linearise(estimate, Observations.of(exact, CORNERS, Mounting.EYE_TO_HAND))
    assert np.abs(found.residuals).max() < 1e-3
    assert (found.jacobian[0, 20:] == 0).all()


def exact_pose(truth: Truth, view: View) -> Transform:
    """X_base_tool that agrees with the view's noiseless corners."""
    X_camera_board = board_pose(view, CORNERS, truth.intrinsics)
    return truth.X_parent_camera @ X_camera_board @ truth.X_parent_board.inverse()
