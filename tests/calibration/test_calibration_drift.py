from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.drift import TagCorners, check_still, compare, find_tags
from calibration.synthetic import D435_720P
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.markers import table_tags

SIDE = 0.05  # m
NOISE = 0.05  # px, of a sharp tag
MIDDLES = [(-0.22, -0.15), (0.22, -0.15), (-0.22, 0.15), (0.22, 0.15)]
X_CAMERA_TABLE = Transform(Rotation.from_euler("x", 20, degrees=True), np.array([0, 0, 0.76]))


def project_tags(X_camera_table: Transform) -> dict[int, Array]:
    square = SIDE / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    K = D435_720P.as_matrix()
    corners = {}
    for i, (x, y) in enumerate(MIDDLES):
        p = X_camera_table @ (square + np.array([x, y, 0]))
        corners[i] = (p @ K.T / p[:, 2:])[:, :2]
    return corners


def noisy(corners: dict[int, Array], rng: np.random.Generator) -> TagCorners:
    return TagCorners(corners={i: c + rng.normal(0, NOISE, (4, 2)) for i, c in corners.items()})


def test_no_false_alarm_in_a_thousand_frames() -> None:
    rng = np.random.default_rng(0)
    still = project_tags(X_CAMERA_TABLE)
    before = noisy(still, rng)
    assert not any(compare(before, noisy(still, rng)).moved for _ in range(1000))


@pytest.mark.parametrize("axis", range(6))
def test_a_small_move_is_seen_in_one_frame(axis: int) -> None:
    """1 mm along or 0.05 degrees about any axis of the camera."""
    rng = np.random.default_rng(axis)
    step = np.zeros(6)
    step[axis] = 1e-3 if axis < 3 else np.deg2rad(0.05)
    moved = Transform(Rotation.from_rotvec(step[3:]), step[:3]) @ X_CAMERA_TABLE
    before, after = project_tags(X_CAMERA_TABLE), project_tags(moved)
    seen = [compare(noisy(before, rng), noisy(after, rng)).moved for _ in range(200)]
    assert all(seen)


def test_one_pushed_tag_is_not_the_tripod() -> None:
    rng = np.random.default_rng(2)
    still = project_tags(X_CAMERA_TABLE)
    pushed = {**still, 2: still[2] + 9.0}
    drift = compare(noisy(still, rng), noisy(pushed, rng))
    assert not drift.moved
    assert drift.tags == 3


def test_hidden_tags_are_named() -> None:
    still = TagCorners(corners=project_tags(X_CAMERA_TABLE))
    two = TagCorners(corners={i: still.corners[i] for i in (0, 1)})
    with pytest.raises(CalibrationError, match="2 of 4 table tags are seen"):
        compare(still, two)


def test_a_move_stops_the_run() -> None:
    still = project_tags(X_CAMERA_TABLE)
    shifted = TagCorners(corners={i: c + 2.0 for i, c in still.items()})
    with pytest.raises(CalibrationError, match="calibrate again"):
        check_still(TagCorners(corners=still), shifted)


def test_tags_are_found_in_a_picture() -> None:
    picture = np.full((300, 300), 255, np.uint8)
    picture[100:200, 60:160] = cv2.aruco.generateImageMarker(table_tags(), 7, 100)
    found = find_tags(picture).corners
    assert list(found) == [7]
    np.testing.assert_allclose(found[7][0], [59.5, 99.5], atol=1.0)
    assert find_tags(np.full((100, 100), 255, np.uint8)).corners == {}
