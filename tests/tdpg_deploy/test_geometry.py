from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tdpg_deploy.geometry import Transform, top_down

coordinate = st.floats(-2, 2)
poses = st.builds(
    lambda t, r: Transform(Rotation.from_rotvec(r), np.array(t)),
    st.tuples(coordinate, coordinate, coordinate),
    st.tuples(coordinate, coordinate, coordinate),
)


@given(poses, poses)
def test_chaining_is_the_product_of_matrices(a: Transform, b: Transform) -> None:
    np.testing.assert_allclose((a @ b).as_matrix(), a.as_matrix() @ b.as_matrix(), atol=1e-12)


@given(poses)
def test_the_inverse_is_the_inverse_matrix(a: Transform) -> None:
    np.testing.assert_allclose(a.inverse().as_matrix(), np.linalg.inv(a.as_matrix()), atol=1e-12)


@given(poses)
def test_every_representation_leads_back(a: Transform) -> None:
    for b in (
        Transform.from_matrix(a.as_matrix()),
        Transform.from_quaternion(a.translation, a.as_quaternion()),
        Transform.from_rotation_vector(a.as_rotation_vector()),
    ):
        metres, radians = a.distance(b)
        assert metres < 1e-12
        assert radians < 1e-7


def test_points_move_as_homogeneous_coordinates_do() -> None:
    X_base_camera = Transform.from_rotation_vector([0.1, -0.2, 0.3, 0.4, 0.5, -0.6])
    p_camera = np.random.default_rng(0).normal(size=(4, 5, 3))
    homogeneous = np.concatenate([p_camera, np.ones((4, 5, 1))], axis=-1)
    expected = homogeneous @ X_base_camera.as_matrix().T
    np.testing.assert_allclose(X_base_camera @ p_camera, expected[..., :3], atol=1e-12)


@pytest.mark.parametrize("yaw", np.linspace(-np.pi, np.pi, 9))
def test_a_top_down_tool_points_down_and_closes_along_yaw(yaw: float) -> None:
    X_base_tool = top_down(0.5, 0.1, 0.0, yaw)
    tip = X_base_tool @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(tip, [0.5, 0.1, -1.0], atol=1e-12)
    pad = X_base_tool @ np.array([1.0, 0.0, 0.0]) - X_base_tool.translation
    np.testing.assert_allclose(pad, [np.cos(yaw), np.sin(yaw), 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "matrix",
    [np.zeros((4, 4)), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan), np.eye(3)],
)
def test_what_is_no_pose_is_refused(matrix: np.ndarray) -> None:  # type: ignore[type-arg]
    with pytest.raises(ValueError, match=r"rotation|\(4, 4\)"):
        Transform.from_matrix(matrix)


def test_a_nan_translation_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        Transform(Rotation.identity(), np.array([0.0, np.nan, 0.0]))
