from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from closed_form import HD, VGA
from scipy import ndimage

from tdpg_deploy.hal import Intrinsics
from tdpg_deploy.sim.depth_noise import D435, StereoNoise, with_stereo_noise

Depth = npt.NDArray[np.float32]
PERFECT = StereoNoise(
    disparity_sd=0.0, disparity_step=1e-7, edge_jitter=0.0, smeared=1e-9, lost=1e-12, grazing=1e9
)


def wall(z: float, camera: Intrinsics = VGA) -> Depth:
    return np.full((camera.height, camera.width), z, np.float32)


def noisy(
    depth: Depth,
    noise: StereoNoise = D435,
    *,
    camera: Intrinsics = VGA,
    luminance: int = 180,
    seed: int = 0,
) -> Depth:
    color = np.full((*depth.shape, 3), luminance, np.uint8)
    return with_stereo_noise(depth, color, camera, np.random.default_rng(seed), noise)


def test_the_same_generator_gives_the_same_noise() -> None:
    assert np.array_equal(noisy(wall(0.7)), noisy(wall(0.7)), equal_nan=True)
    assert not np.array_equal(noisy(wall(0.7)), noisy(wall(0.7), seed=1), equal_nan=True)


def test_true_depth_is_left_as_it_is() -> None:
    depth = wall(0.7)
    noisy(depth)
    assert (depth == np.float32(0.7)).all()


@pytest.mark.parametrize("camera", [VGA, HD])
@pytest.mark.parametrize("z", [0.4, 0.7, 1.0, 1.4])
def test_the_error_grows_with_z_squared(camera: Intrinsics, z: float) -> None:
    """sigma_z = z^2 * sigma_disparity / (focal * baseline), with the step's own error."""
    error = noisy(wall(z, camera), camera=camera) - z
    step = D435.disparity_step
    in_disparity = np.hypot(D435.disparity_sd, step / np.sqrt(12))
    expected = z**2 * in_disparity / (D435.focal * D435.baseline)
    assert np.nanstd(error) == pytest.approx(expected, rel=0.06)
    assert abs(np.nanmean(error)) < 0.1 * expected


def test_at_070_m_the_error_is_that_of_a_d435() -> None:
    assert 0.001 < np.nanstd(noisy(wall(0.7)) - 0.7) < 0.002


def test_depth_comes_in_steps_of_disparity() -> None:
    seen = noisy(wall(0.7))
    steps = D435.focal * D435.baseline / seen[np.isfinite(seen)] / D435.disparity_step
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)


def test_neighbours_err_alike_and_distant_pixels_do_not() -> None:
    seen = np.nan_to_num(noisy(wall(0.7), replace(D435, lost=1e-9)) - 0.7)

    def correlation(apart: int) -> float:
        return float(np.corrcoef(seen[:, :-apart].ravel(), seen[:, apart:].ravel())[0, 1])

    assert correlation(1) > 0.8
    assert abs(correlation(30)) < 0.05


def test_holes_are_rare_blotches_on_a_bright_wall() -> None:
    holes = np.isnan(noisy(wall(0.7)))
    assert holes.mean() == pytest.approx(D435.lost, rel=0.6)
    _, count = ndimage.label(holes)
    assert holes.sum() / count > 4


def test_a_dark_wall_has_more_holes() -> None:
    holes = np.isnan(noisy(wall(0.7), luminance=20))
    assert holes.mean() == pytest.approx(D435.dark_holes, rel=0.15)


def test_a_grazing_surface_is_not_matched() -> None:
    """Depth that grows along the rows: 1 / z, so disparity, has a constant slope."""
    row = np.arange(VGA.height)[:, None]
    for slope, seen_share in ((0.2, 1.0), (0.5, 0.0)):
        disparity = 5 + slope * row + np.zeros((1, VGA.width))
        depth = (VGA.fx * PERFECT.baseline / disparity).astype(np.float32)
        seen = noisy(depth, replace(PERFECT, grazing=D435.grazing, nearest=1e-3))
        assert np.isfinite(seen[2:-2]).mean() == pytest.approx(seen_share, abs=0.01)


def test_the_shadow_lies_left_of_an_edge_and_is_as_wide_as_the_disparities_differ() -> None:
    near, far = 0.6, 0.8
    depth = wall(far)
    depth[200:300, 300:400] = near
    holes = np.isnan(noisy(depth, PERFECT))
    width = VGA.fx * PERFECT.baseline * (1 / near - 1 / far)
    assert holes[200:300].sum(axis=1) == pytest.approx(width, abs=1)
    columns = np.nonzero(holes[250])[0]
    assert columns[0] == pytest.approx(300 - width, abs=1)
    assert columns[-1] == 299
    assert not holes[:200].any()
    assert not holes[300:].any()


def test_edges_are_ragged_and_smeared() -> None:
    near, far = 0.6, 0.8
    depth = wall(far)
    depth[200:300] = near
    ragged = noisy(depth, replace(PERFECT, edge_jitter=D435.edge_jitter))
    swapped = np.abs(ragged - depth) > 0.1
    assert 0.05 < swapped[197:203].mean() < 0.5
    assert not swapped[220:280].any()
    assert set(np.round(ragged[np.isfinite(ragged)], 4)) == {np.float32(near), np.float32(far)}

    smeared = noisy(depth, replace(PERFECT, edge_jitter=D435.edge_jitter, smeared=D435.smeared))
    between = (smeared > near + 0.01) & (smeared < far - 0.01)
    assert 0.02 < between[197:203].mean() < D435.smeared
    assert not between[220:280].any()
    assert np.nanmin(smeared) >= near - 1e-4
    assert np.nanmax(smeared) <= far + 1e-4


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0, 0.15])
def test_what_has_no_depth_or_is_too_near_stays_unknown(value: float) -> None:
    depth = wall(0.7)
    depth[100:200, 100:200] = value
    seen = noisy(depth, PERFECT)
    assert np.isnan(seen[100:200, 100:200]).all()
    assert np.isfinite(seen[:, 300:]).all()


def test_with_no_error_depth_is_exact() -> None:
    depth = np.tile(np.linspace(0.5, 0.9, VGA.width, dtype=np.float32), (VGA.height, 1))
    seen = noisy(depth, PERFECT)
    np.testing.assert_allclose(seen, depth, rtol=1e-5)
