from __future__ import annotations

import numpy as np
import pytest

from calibration.depth import DepthSamples, fit_depth, sample_depth
from calibration.pictures import board_in_front, paint_board
from calibration.synthetic import D435_720P
from calibration.target import DEFAULT_TARGET
from tdpg_deploy.depth_model import DepthModel
from tdpg_deploy.errors import CalibrationError

BASELINE = 0.05  # m, D435
LENS = D435_720P


def seen(rng: np.random.Generator, scale: float, offset_px: float) -> list[DepthSamples]:
    """A stereo camera whose depth is `scale` too long and whose disparity is `offset_px` short."""
    samples = []
    for depth in np.linspace(0.5, 1.1, 15):
        z = depth + rng.uniform(-0.03, 0.03, 27)
        disparity = LENS.fx * BASELINE / (scale * z) - offset_px
        noise = rng.normal(0, 0.01, z.shape)  # px, of a median over a square
        samples.append(DepthSamples(expected=z, measured=LENS.fx * BASELINE / (disparity + noise)))
    return samples


def test_scale_and_disparity_errors_are_corrected_below_a_tenth_of_a_millimetre() -> None:
    samples = seen(np.random.default_rng(0), scale=1.01, offset_px=0.1)
    model, quality = fit_depth(samples)
    assert quality.offset > 3e-3
    z = np.linspace(0.5, 1.1, 50)
    measured = LENS.fx * BASELINE / (LENS.fx * BASELINE / (1.01 * z) - 0.1)
    corrected = model.correct(measured.astype(np.float32))
    assert np.abs(corrected - z).max() < 0.1e-3


def test_shiny_squares_do_not_bend_the_model() -> None:
    rng = np.random.default_rng(1)
    samples = seen(rng, scale=1.0, offset_px=0.0)
    for sample in samples:
        sample.measured[rng.choice(27, 3, replace=False)] += 0.05
        sample.measured[rng.choice(27, 3, replace=False)] = np.nan
    model, quality = fit_depth(samples)
    assert model.correct(np.array([0.8], np.float32))[0] == pytest.approx(0.8, abs=0.3e-3)
    assert 0.8 < quality.fill < 0.95


def test_depth_is_read_inside_white_squares() -> None:
    X = board_in_front(DEFAULT_TARGET, 0.7)
    depth = np.full((720, 1280), np.nan, np.float32)
    paint_board(np.zeros((720, 1280, 3), np.uint8), DEFAULT_TARGET, X, LENS, depth)
    found = sample_depth(depth, DEFAULT_TARGET, X, LENS)
    assert np.isfinite(found.measured).all()
    np.testing.assert_allclose(found.measured, found.expected, atol=0.2e-3)


def test_unknown_stays_unknown() -> None:
    assert np.isnan(DepthModel(a=1.01, b=0.0).correct(np.array([np.nan], np.float32))[0])


@pytest.mark.parametrize(
    ("expected", "measured", "message"),
    [
        (np.full(10, 0.7), np.full(10, 0.7), "10 white squares"),
        (np.full(50, 0.7), np.full(50, 0.7), "within 0 mm of depth"),
        (np.linspace(0.5, 0.9, 50), 0.5 * np.linspace(0.5, 0.9, 50), "not be aligned"),
    ],
)
def test_what_cannot_be_corrected_is_refused(
    expected: np.ndarray[tuple[int], np.dtype[np.float64]],
    measured: np.ndarray[tuple[int], np.dtype[np.float64]],
    message: str,
) -> None:
    with pytest.raises(CalibrationError, match=message):
        fit_depth([DepthSamples(expected=expected, measured=measured)])
