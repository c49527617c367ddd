"""Every known mistake is named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.solve import solve
from calibration.synthetic import D435_720P, Truth, make_truth, observe
from calibration.target import DEFAULT_TARGET
from calibration.views import Mounting, PoseNoise, View
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Transform

CORNERS = DEFAULT_TARGET.corners()
HAND = Mounting.EYE_TO_HAND


@pytest.fixture(scope="module", params=list(Mounting))
def case(request: pytest.FixtureRequest) -> tuple[Truth, list[View]]:
    rng = np.random.default_rng(1)
    truth = make_truth(request.param, CORNERS, rng)
    return truth, observe(truth, 16, rng)


def with_poses(views: Sequence[View], poses: Sequence[Transform]) -> list[View]:
    return [replace(view, X_base_tool=X) for view, X in zip(views, poses, strict=True)]


def solved_wrong(truth: Truth, views: Sequence[View], mounting: Mounting | None = None) -> str:
    with pytest.raises(CalibrationError) as caught:
        solve(views, CORNERS, truth.intrinsics, mounting or truth.mounting)
    return str(caught.value)


def test_swapped_mounting(case: tuple[Truth, list[View]]) -> None:
    truth, views = case
    message = solved_wrong(truth, views, truth.mounting.other)
    assert f"choose {truth.mounting.value}" in message


REARRANGEMENTS: dict[str, tuple[Callable[[list[Transform]], list[Transform]], str]] = {
    "inverted": (lambda poses: [X.inverse() for X in poses], "poses are inverted"),
    "reversed": (lambda poses: poses[::-1], "in reverse order"),
    "shifted": (lambda poses: [*poses[1:], poses[0]], "shifted by one"),
    "shifted back": (lambda poses: [poses[-1], *poses[:-1]], "shifted by one"),
    "shuffled": (
        lambda poses: [poses[i] for i in np.random.default_rng(0).permutation(len(poses))],
        "out of order",
    ),
    "scalar first": (
        lambda poses: [
            Transform(Rotation.from_quat(np.roll(X.rotation.as_quat(), 1)), X.translation)
            for X in poses
        ],
        "scalar first",
    ),
    "millimetres": (
        lambda poses: [Transform(X.rotation, 1e3 * X.translation) for X in poses],
        "mm",
    ),
    "degrees": (
        lambda poses: [
            Transform(Rotation.from_rotvec(np.rad2deg(X.rotation.as_rotvec())), X.translation)
            for X in poses
        ],
        "radians, not degrees",
    ),
}


@pytest.mark.parametrize("mistake", REARRANGEMENTS)
def test_mistakes_in_poses(case: tuple[Truth, list[View]], mistake: str) -> None:
    truth, views = case
    change, expected = REARRANGEMENTS[mistake]
    poses = [view.X_base_tool for view in views]
    assert expected in solved_wrong(truth, with_poses(views, change(poses)))


def test_duplicates_are_left_out_and_named(case: tuple[Truth, list[View]]) -> None:
    truth, views = case
    again = [*views, replace(views[4], name="again")]
    found = solve(again, CORNERS, truth.intrinsics, truth.mounting)
    assert len(found.views) == len(views)
    assert found.notes == ("again: duplicate of 004, left out",)


def test_a_stale_frame_is_named_and_gated(case: tuple[Truth, list[View]]) -> None:
    truth, views = case
    stale = [*views[:-1], replace(views[-1], ids=views[3].ids, corners=views[3].corners)]
    found = solve(stale, CORNERS, truth.intrinsics, truth.mounting)
    assert not found.views[-1].used
    assert "003 and 015 are the same picture" in found.notes[0]


def test_too_few_views(case: tuple[Truth, list[View]]) -> None:
    truth, views = case
    assert "3 usable views are too few: add 2" in solved_wrong(truth, views[:3])


def test_turns_about_one_axis_and_none() -> None:
    rng = np.random.default_rng(2)
    truth = make_truth(HAND, CORNERS, rng)
    assert "about one axis" in solved_wrong(truth, observe(truth, 12, rng, tilt=0.0))
    assert "hardly turned" in solved_wrong(truth, observe(truth, 12, rng, tilt=0.0, spin=0.0))


def test_a_board_of_another_size_is_named() -> None:
    rng = np.random.default_rng(3)
    truth = make_truth(HAND, CORNERS, rng)
    views = observe(truth, 15, rng)
    with pytest.raises(CalibrationError, match=r"measures 1\.04\d of the size given|agree"):
        solve(views, CORNERS / 1.045, truth.intrinsics, HAND)


def test_corners_of_another_board_are_refused(case: tuple[Truth, list[View]]) -> None:
    truth, views = case
    wrong = [replace(views[0], ids=views[0].ids + 1000), *views[1:]]
    assert "ids" in solved_wrong(truth, wrong)


@pytest.mark.parametrize(
    "change", [{"fx": 1.08 * D435_720P.fx, "fy": 1.08 * D435_720P.fy}, {"cx": 560.0}]
)
def test_a_foreign_lens_is_named(change: dict[str, Any]) -> None:
    rng = np.random.default_rng(5)
    truth = make_truth(HAND, CORNERS, rng)
    given = replace(truth.intrinsics, **change)
    with pytest.raises(CalibrationError, match="intrinsics given are not those of these pictures"):
        solve(observe(truth, 12, rng), CORNERS, given, HAND)


def test_poses_worse_than_any_arms_are_noted() -> None:
    """As nominal kinematics give them: millimetres off, each in its own way."""
    rng = np.random.default_rng(6)
    truth = make_truth(HAND, CORNERS, rng)
    nominal = PoseNoise(translation=1.5e-3, rotation=2e-3)
    found = solve(observe(truth, 16, rng, pose_noise=nominal), CORNERS, truth.intrinsics, HAND)
    assert "not from nominal kinematics" in found.notes[-1]
