"""Error of hand-eye calibration on synthetic truth, beside OpenCV's methods and the bound.

Truth and noise come from `calibration.synthetic` (pixels by OpenCV's projection); the Cramer-Rao
bound is computed here from differences of that projection, so nothing of the solver judges
itself. Sequences of the package kinhec are added when it is installed.
"""

from __future__ import annotations

import importlib.util
from collections import defaultdict
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from calibration.synthetic import Truth
from calibration.views import Mounting, PoseNoise, View
from tdpg_deploy.geometry import Array, Transform
from tools.benchmark.calibration_cases import (
    PIXEL_NOISE,
    POSE_NOISE,
    Case,
    bad_views_case,
    clean_case,
    stretched_board_case,
    wrong_lens_case,
)
from tools.benchmark.measure import Measurement
from tools.benchmark.opencv_hand_eye import solve_with_opencv

TRIALS = 90
STRETCHED = "board x 1.005"
STRESSES: dict[str, Callable[[Mounting, int], Case]] = {
    "20 % bad views": bad_views_case,
    "lens off by 0.3 %, 3 px": wrong_lens_case,
    STRETCHED: stretched_board_case,
}


def run() -> list[Measurement]:
    """Camera place errors in mm: median, 5 to 95 %; reference: the bound on the same data. Then
    what a calibration is for, and what guards it."""
    from tools.benchmark.calibration_cell import measure_landing  # physics: not for the rest
    from tools.benchmark.calibration_checks import measure_depth, measure_drift

    return [
        *measure_clean(),
        *measure_stressed(),
        *measure_kinhec(),
        measure_depth(),
        *measure_drift(),
        measure_landing(),
    ]


def measure_clean() -> list[Measurement]:
    results = []
    inside: list[float] = []
    for mounting in Mounting:
        errors: dict[str, list[float]] = defaultdict(list)
        for seed in range(TRIALS):
            case = clean_case(mounting, seed)
            found = case.solve()
            errors["this solver"].append(case.error(found.X_parent_camera))
            inside.append(float(case.within(found, 0.95)))
            for name, X in solve_with_opencv(case).items():
                errors[name].append(case.error(X))
            errors["Cramer-Rao bound"] += bound_draws(case.truth, case.views, seed)
        bound = float(np.median(errors["Cramer-Rao bound"]))
        results += [
            _measurement(f"{mounting.value}: {name}", values, bound)
            for name, values in errors.items()
        ]
    inside_each = [100 * float(np.mean(part)) for part in (inside[:TRIALS], inside[TRIALS:])]
    results.append(
        Measurement(
            name="errors inside the 95 % region",
            unit="%",
            median=100 * float(np.mean(inside)),
            low=min(inside_each),
            high=max(inside_each),
            repeats=len(inside),
        )
    )
    return results


def measure_stressed() -> list[Measurement]:
    """Reference: for a board of unknown size, the bound on the same data."""
    results = []
    for name, make in STRESSES.items():
        for mounting in Mounting:
            cases = [make(mounting, seed) for seed in range(TRIALS)]
            bound = _median_bound(cases, scale_known=False) if name == STRETCHED else None
            results.append(_measurement(f"{mounting.value}, {name}", _errors(cases), bound))
    return results


def measure_kinhec() -> list[Measurement]:
    """Nothing where the package is not installed."""
    if importlib.util.find_spec("kinhec") is None:
        return []
    from tools.benchmark.kinhec_cases import kinhec_case

    sequences = (kinhec_case(seed) for seed in range(TRIALS))
    cases = [case for case in sequences if case is not None]
    bound = _median_bound(cases)
    return [_measurement("kinhec eye-to-hand, 7 x 5 corners", _errors(cases), bound)]


def _median_bound(cases: Sequence[Case], *, scale_known: bool = True) -> float:
    draws = [
        bound_draws(case.truth, case.views, seed, scale_known=scale_known)
        for seed, case in enumerate(cases)
    ]
    return float(np.median(draws))


def bound_draws(
    truth: Truth, views: Sequence[View], seed: int, draws: int = 50, *, scale_known: bool = True
) -> list[float]:
    """Place errors (mm) of an estimator that attains the Cramer-Rao bound, drawn at random."""
    information = _fisher_information(truth, views, POSE_NOISE)
    known = information[:12, :12] if scale_known else information
    covariance = np.linalg.inv(known)[3:6, 3:6]
    rng = np.random.default_rng([seed, 99])
    drawn = rng.multivariate_normal(np.zeros(3), covariance, draws)
    return [float(1e3 * np.linalg.norm(error)) for error in drawn]


def _fisher_information(truth: Truth, views: Sequence[View], noise: PoseNoise) -> Array:
    """(13, 13) of steps of both poses and of the board's scale, arm errors marginalised, by
    central differences."""
    information = np.zeros((13, 13))
    for view in views:
        arm = view.X_parents(truth.mounting)

        def pixels(step: Array, arm: Transform = arm, view: View = view) -> Array:
            camera = truth.X_parent_camera @ _small(step[0:6])
            board = truth.X_parent_board @ _small(step[6:12])
            erring = _small(step[13:19])
            eye_to_hand = truth.mounting is Mounting.EYE_TO_HAND
            moved = arm @ erring if eye_to_hand else erring.inverse() @ arm
            X = camera.inverse() @ moved @ board
            seen, _ = cv2.projectPoints(
                (1 + step[12]) * truth.board_corners[view.ids],
                X.rotation.as_rotvec(),
                X.translation,
                truth.intrinsics.as_matrix(),
                np.array(truth.intrinsics.distortion),
            )
            return np.asarray(seen, np.float64).ravel()

        h = 1e-6
        columns = [(pixels(step) - pixels(-step)) / (2 * h) for step in h * np.eye(19)]
        J = np.stack(columns, axis=1)
        G = J[:, 13:]
        spread = PIXEL_NOISE**2 * np.eye(len(J)) + G @ np.diag(noise.variances()) @ G.T
        information += J[:, :13].T @ np.linalg.solve(spread, J[:, :13])
    return information


def _small(step: Array) -> Transform:
    return Transform(Rotation.from_rotvec(step[:3]), step[3:])


def _errors(cases: Sequence[Case]) -> list[float]:
    return [case.error(case.solve().X_parent_camera) for case in cases]


def _measurement(name: str, values: Sequence[float], bound: float | None = None) -> Measurement:
    low, median, high = np.percentile(values, [5, 50, 95])
    return Measurement(
        name=name,
        unit="mm",
        median=float(median),
        low=float(low),
        high=float(high),
        reference=bound,
        repeats=len(values),
    )
