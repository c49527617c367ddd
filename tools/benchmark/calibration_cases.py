"""The cases that calibration is measured on: synthetic truth, spoiled in known ways."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from calibration.refine import Freedom
from calibration.solve import HandEye, solve
from calibration.synthetic import Truth, make_truth, observe
from calibration.target import DEFAULT_TARGET
from calibration.views import Mounting, PoseNoise, View
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

VIEWS, PIXEL_NOISE, POSE_NOISE = 25, 0.25, PoseNoise()


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """What the solver is given. `truth` made the views; lens and board are what is believed."""

    truth: Truth
    views: Sequence[View]
    intrinsics: Intrinsics
    board_corners: Array

    def solve(self, freedoms: Sequence[Freedom] | None = None) -> HandEye:
        return solve(
            self.views,
            self.board_corners,
            self.intrinsics,
            self.truth.mounting,
            freedoms=freedoms,
        )

    def error(self, X_parent_camera: Transform) -> float:
        """Millimetres between the camera's place and the truth."""
        return 1e3 * self.truth.X_parent_camera.distance(X_parent_camera)[0]

    def within(self, found: HandEye, probability: float) -> bool:
        """Whether the truth lies in the region that `found.covariance` draws."""
        X, X_true = found.X_parent_camera, self.truth.X_parent_camera
        turn = (X.rotation * X_true.rotation.inv()).as_rotvec()
        error = np.concatenate([X.translation - X_true.translation, turn])
        squared = float(error @ np.linalg.solve(found.covariance, error))
        return squared < float(chi2.ppf(probability, len(error)))


def clean_case(mounting: Mounting, seed: int) -> Case:
    rng = np.random.default_rng([seed, mounting is Mounting.EYE_IN_HAND])
    corners = DEFAULT_TARGET.corners()
    truth = make_truth(mounting, corners, rng)
    views = observe(truth, VIEWS, rng, pixel_noise=PIXEL_NOISE, pose_noise=POSE_NOISE)
    return Case(truth=truth, views=views, intrinsics=truth.intrinsics, board_corners=corners)


def bad_views_case(mounting: Mounting, seed: int) -> Case:
    """A fifth of the views spoiled: a foreign pose, a pose read in motion, a smeared picture."""
    case = clean_case(mounting, seed)
    rng = np.random.default_rng([seed, 20])
    views = list(case.views)
    for i, bad in enumerate(rng.choice(VIEWS, VIEWS // 5, replace=False)):
        view = views[bad]
        if i % 3 == 0:
            other = case.views[(bad + 1) % VIEWS].X_base_tool
            views[bad] = replace(view, X_base_tool=other)
        elif i % 3 == 1:
            turn = Rotation.from_rotvec(rng.normal(0, np.deg2rad(1), 3))
            moved = Transform(turn, rng.normal(0, 0.01, 3))
            views[bad] = replace(view, X_base_tool=view.X_base_tool @ moved)
        else:
            smeared = view.corners + rng.normal(0, 4, 2) + rng.normal(0, 2, view.corners.shape)
            views[bad] = replace(view, corners=smeared)
    return replace(case, views=views)


def wrong_lens_case(mounting: Mounting, seed: int) -> Case:
    """Focal length off by 0.3 %, centre by 3 px, a mild distortion that is not known."""
    case = clean_case(mounting, seed)
    rng = np.random.default_rng([seed, 21])
    k = case.intrinsics
    angle, sign = rng.uniform(0, 2 * np.pi), rng.choice([-1, 1], 2)
    true_lens = replace(
        k,
        fx=k.fx * (1 + 0.003 * sign[0]),
        fy=k.fy * (1 + 0.003 * sign[0]),
        cx=k.cx + 3 * np.cos(angle),
        cy=k.cy + 3 * np.sin(angle),
        distortion=(0.02 * sign[1], -0.01 * sign[1], 0.0, 0.0, 0.0),
    )
    truth = replace(case.truth, intrinsics=true_lens)
    views = observe(truth, VIEWS, rng, pixel_noise=PIXEL_NOISE, pose_noise=POSE_NOISE)
    return replace(case, truth=truth, views=views)


def stretched_board_case(mounting: Mounting, seed: int) -> Case:
    """Printed 0.5 % too large."""
    case = clean_case(mounting, seed)
    rng = np.random.default_rng([seed, 22])
    truth = replace(case.truth, board_corners=1.005 * case.board_corners)
    views = observe(truth, VIEWS, rng, pixel_noise=PIXEL_NOISE, pose_noise=POSE_NOISE)
    return replace(case, truth=truth, views=views)
