"""The joint fit against SciPy's least squares, and the arm's noise against its likelihood."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import least_squares, minimize_scalar
from scipy.spatial.transform import Rotation

from calibration.projection import LENS, SCALE, Estimate, Observations, linearise
from calibration.refine import PRIOR, Freedom, Noise, Split, fit
from calibration.synthetic import make_truth, observe
from calibration.target import DEFAULT_TARGET
from calibration.views import Mounting, PoseNoise
from tdpg_deploy.geometry import Array, Transform

CORNERS = DEFAULT_TARGET.corners()
NOISE = Noise(pixel=0.25, pose=PoseNoise().variances())


@pytest.mark.parametrize("mounting", Mounting)
def test_fit_is_least_squares_of_whitened_residuals_and_priors(mounting: Mounting) -> None:
    """Three views tell so little of the lens that its priors take part."""
    rng = np.random.default_rng(11)
    truth = make_truth(mounting, CORNERS, rng)
    views = observe(truth, 3, rng)
    k = truth.intrinsics
    nominal = Estimate(
        X_parent_camera=truth.X_parent_camera,
        X_parent_board=truth.X_parent_board,
        intrinsics=replace(k, fx=1.004 * k.fx, fy=1.003 * k.fy, cx=k.cx + 2),
    )
    seen = Observations.of(views, CORNERS, mounting)
    found = fit(nominal, nominal, seen, NOISE, Freedom(lens=True, scale=True))

    spread = [
        NOISE.pixel**2 * np.eye(len(G)) + G @ np.diag(NOISE.pose) @ G.T
        for G in linearise(found.estimate, seen).pose_jacobian
    ]
    whitening = np.linalg.inv(np.linalg.cholesky(block_diag(*spread)))

    def residuals(step: Array) -> Array:
        camera, board = (
            X @ Transform(Rotation.from_rotvec(s[:3]), s[3:])
            for X, s in [
                (nominal.X_parent_camera, step[0:6]),
                (nominal.X_parent_board, step[6:12]),
            ]
        )
        lens, scale = step[LENS], step[SCALE]
        n = nominal.intrinsics
        matrix = np.diag([n.fx * (1 + lens[0]), n.fy * (1 + lens[1]), 1.0])
        matrix[:2, 2] = n.cx + lens[2], n.cy + lens[3]
        pixels = np.zeros_like(seen.pixels)
        for i, view in enumerate(views):
            X = camera.inverse() @ view.X_parents(mounting) @ board
            points = (1 + scale) * CORNERS[view.ids]
            projected, _ = cv2.projectPoints(
                points, X.rotation.as_rotvec(), X.translation, matrix, np.array([*lens[4:], 0, 0])
            )
            pixels[i, : len(view.ids)] = projected.reshape(-1, 2)
        misses = ((pixels - seen.pixels) * seen.seen[..., None]).ravel()
        return np.concatenate([whitening @ misses, (step / PRIOR)[12:]])

    reference = least_squares(
        residuals, np.zeros(19), jac="3-point", x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    jacobian = np.asarray(reference.jac)
    deviation = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance())), deviation, rtol=0.02)
    assert (deviation[LENS] > 0.1 * PRIOR[LENS]).any()  # or the priors were not tried

    step = reference.x
    expected_camera = nominal.X_parent_camera @ Transform(Rotation.from_rotvec(step[:3]), step[3:6])
    distance, angle = expected_camera.distance(found.estimate.X_parent_camera)
    assert distance < 0.01 * deviation[3:6].max()
    assert angle < 0.01 * deviation[:3].max()
    lens, n = found.estimate.intrinsics, nominal.intrinsics
    moved = [lens.fx / n.fx - 1, lens.fy / n.fy - 1, lens.cx - n.cx, lens.cy - n.cy]
    moved += [*lens.distortion[:2], found.estimate.scale - 1]
    assert (np.abs(moved - step[12:]) < 0.01 * deviation[12:]).all()


def drawn(factor: float, rng: np.random.Generator, views: int = 25) -> Split:
    """Moves of an arm that is `factor` times as noisy as NOISE says, as corners show them: well
    along the picture and about the line of sight, badly in depth and tilt. Of their variance
    12 parameters, fitted, have taken their part."""
    sharpness = np.stack(
        [
            np.diag(NOISE.pixel**2 / (blur * np.array([4e-4, 4e-4, 4e-5, 3e-5, 3e-5, 2e-4])) ** 2)
            for blur in rng.uniform(0.7, 1.4, views)
        ]
    )
    spread = NOISE.pixel**2 * np.linalg.inv(sharpness) + factor**2 * np.diag(NOISE.pose)
    moves = np.stack([rng.multivariate_normal(np.zeros(6), (1 - 2 / views) * S) for S in spread])
    counts = np.full(views, 96)
    return Split(
        left=NOISE.pixel**2 * (counts - 6.0), moves=moves, sharpness=sharpness, counts=counts
    )


def test_noise_of_the_arm_is_the_most_likely_one() -> None:
    split = drawn(2.0, np.random.default_rng(1))
    left = 1 - 2 / len(split.counts)

    def unlikely(log_factor: float) -> float:
        corners = NOISE.pixel**2 * np.linalg.inv(split.sharpness)
        spread = corners + np.exp(2 * log_factor) * np.diag(NOISE.pose)
        fits = [m @ np.linalg.solve(S, m) for m, S in zip(split.moves, spread, strict=True)]
        return float(left * np.linalg.slogdet(spread).logabsdet.sum() + sum(fits))

    expected = np.exp(minimize_scalar(unlikely, bounds=(0, 3), method="bounded").x)
    assert split.pose_noise_factor(NOISE, robust=False) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("factor", [1.0, 3.0, 10.0])
def test_noise_of_the_arm_is_known_well(factor: float) -> None:
    rng = np.random.default_rng(2)
    found = [drawn(factor, rng).pose_noise_factor(NOISE, robust=False) for _ in range(60)]
    assert np.median(found) == pytest.approx(factor, rel=0.05)
    assert np.percentile(found, 95) < 1.35 * factor
