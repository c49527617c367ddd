"""Where the board is wanted next: shown whole, not hidden by the arm, and said in words."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.arm_shape import hides, rods
from calibration.coverage import ENOUGH, coverage, view_parameters
from calibration.live import describe
from calibration.poses import candidates
from calibration.projection import Estimate
from calibration.synthetic import D435_720P, make_truth, observe
from calibration.target import DEFAULT_TARGET
from calibration.views import Mounting, View
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.kinematics import UR5, forward

CORNERS = DEFAULT_TARGET.corners()
CELL = load_cell(DEFAULT_CELL)
TOOL = CELL.arm.X_flange_tool.transform()


def test_rods_hang_together_and_end_at_the_gripper() -> None:
    """Against the closed form: DH distances between joints, and the flange."""
    rng = np.random.default_rng(0)
    for q in rng.uniform(-np.pi, np.pi, (50, 6)):
        ends = rods(UR5, q, TOOL)
        np.testing.assert_allclose(ends[1:, 0], ends[:-1, 1], atol=1e-9)
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        assert lengths[[0, 2, 4]] == pytest.approx([0.089159, 0.425, 0.39225])
        assert lengths[6:8] == pytest.approx([UR5.d5, UR5.d6])
        flange = forward(UR5, q, Transform.identity())
        np.testing.assert_allclose(ends[8, 0], flange.translation, atol=1e-9)


def test_what_stands_behind_the_forearm_is_hidden() -> None:
    q = np.array(CELL.arm.home)
    forearm = rods(UR5, q, TOOL)[4].mean(axis=0)
    eye = forearm + np.array([0.5, 0.0, 0.3])
    behind = forearm - 0.4 * (eye - forearm)
    around = behind + 0.01 * np.random.default_rng(0).normal(size=(20, 3))
    assert hides(UR5, q, TOOL, eye, around)
    assert not hides(UR5, q, TOOL, eye, around + np.array([0.0, 1.5, 0.0]))
    assert not hides(UR5, q, TOOL, eye, (eye + forearm) / 2 + 0.01 * np.eye(3))  # in front of it


@pytest.mark.parametrize("mounting", Mounting)
def test_candidates_show_the_whole_board_by_opencvs_projection(mounting: Mounting) -> None:
    rng = np.random.default_rng(1)
    truth = make_truth(mounting, CORNERS, rng)
    guess = Estimate(
        X_parent_camera=truth.X_parent_camera,
        X_parent_board=truth.X_parent_board,
        intrinsics=truth.intrinsics,
    )
    hidden: list[Array] = []

    def hides_every_third(q: Array, eye: Array, points: Array) -> bool:
        hidden.append(q)
        return len(hidden) % 3 == 0

    offered = candidates(
        guess, mounting, CORNERS, lambda X: X.translation, hides_every_third, -1.0, rng, 40
    )
    assert len(offered) == 40
    assert (len(hidden) > 40) == (mounting is Mounting.EYE_TO_HAND)
    for candidate in offered:
        X = candidate.X_camera_board
        arm = View(
            name="", X_base_tool=candidate.X_base_tool, ids=np.arange(1), corners=np.zeros((1, 2))
        ).X_parents(mounting)
        seen = guess.X_parent_camera.inverse() @ arm @ guess.X_parent_board
        assert max(seen.distance(X)) < 1e-9
        pixels, _ = cv2.projectPoints(
            CORNERS,
            X.rotation.as_rotvec(),
            X.translation,
            D435_720P.as_matrix(),
            np.zeros(5),
        )
        inside = pixels.reshape(-1, 2)
        assert inside.min() > 20
        assert (inside < [1260, 700]).all()
        squares = np.linalg.norm(np.diff(inside[:8], axis=0), axis=1)
        assert np.median(squares) > 28 * np.cos(np.deg2rad(40))


def flat_view(scale: float, middle: tuple[float, float]) -> View:
    """A board seen squarely: `scale` px per metre, its middle at a pixel."""
    corners = scale * (CORNERS - CORNERS.mean(axis=0))[:, :2] + middle
    return View(
        name="v", X_base_tool=Transform.identity(), ids=np.arange(len(CORNERS)), corners=corners
    )


def test_coverage_is_that_of_camera_calibration() -> None:
    """By hand: corners span 7 x 4 squares of 28 mm."""
    scale = 1000.0
    area = 7 * 4 * 28.0**2
    found = view_parameters(flat_view(scale, (639.5, 359.5)), CORNERS, D435_720P)
    border = np.sqrt(area)
    across = (639.5 - border / 2) / (1280 - border)
    assert found == pytest.approx([across, 0.5, np.sqrt(area / (1280 * 720)), 0.0], abs=2e-3)
    views = [flat_view(scale, (200.0, 200.0)), flat_view(2 * scale, (900.0, 500.0))]
    parts = np.stack([view_parameters(view, CORNERS, D435_720P) for view in views])
    expected = np.minimum(np.ptp(parts, axis=0) / ENOUGH, 1.0)
    assert coverage(views, CORNERS, D435_720P).share == pytest.approx(expected)
    assert coverage([], CORNERS, D435_720P).share == pytest.approx(np.zeros(4))
    rng = np.random.default_rng(0)
    truth = make_truth(Mounting.EYE_TO_HAND, CORNERS, rng)
    assert coverage(observe(truth, 25, rng), CORNERS, D435_720P).share[[0, 1, 3]].min() > 0.9


def seen_at(x: float, y: float, z: float, rotation: Rotation) -> Transform:
    middle = np.array([*DEFAULT_TARGET.size, 0.0]) / 2
    return Transform(rotation, np.array([x, y, z]) - rotation.apply(middle))


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        (seen_at(0, 0, 0.5, Rotation.identity()), "board in the middle, 0.50 m away"),
        (
            seen_at(-0.2, -0.1, 0.6, Rotation.from_euler("z", 30, degrees=True)),
            "board in the upper left, 0.64 m away, turned 30 degrees clockwise",
        ),
        (
            seen_at(0.2, 0, 0.6, Rotation.from_euler("y", 20, degrees=True)),
            "board in the middle right, 0.63 m away, its right side leaned 20 degrees towards the "
            "camera",
        ),
        (
            seen_at(0, 0.2, 0.6, Rotation.from_euler("x", 20, degrees=True)),
            "board in the lower middle, 0.63 m away, its upper side leaned 20 degrees towards the "
            "camera",
        ),
    ],
)
def test_places_in_words(pose: Transform, said: str) -> None:
    assert describe(pose, DEFAULT_TARGET) == said
    if "leaned" in said:  # the side that is said is the nearer one
        corners = pose @ CORNERS
        side = {"right": 0, "upper": 1}["right" if "right side" in said else "upper"]
        nearer = corners[corners[:, 2].argmin()] - corners.mean(axis=0)
        assert (nearer[side] > 0) == (side == 0)
