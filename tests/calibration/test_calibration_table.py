"""The table's plane, through a lens that OpenCV distorts, with things lying on it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.command_solve import table_problem
from calibration.synthetic import D435_720P
from calibration.table import TablePlane, fit_table, workspace_points
from tdpg_deploy.cell_config import DEFAULT_CELL, WorkspaceSection, load_cell
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array

SQUARE = WorkspaceSection()
CELL = load_cell(DEFAULT_CELL)


def points(height: float, tilt: float, rng: np.random.Generator) -> Array:
    """(n, 3) of a table that rises along y, with 1 mm of noise, and a block on it."""
    x, y = rng.uniform(*SQUARE.x_range, 5000), rng.uniform(*SQUARE.y_range, 5000)
    z = height + np.tan(tilt) * (y - SQUARE.center[1]) + rng.normal(0, 1e-3, 5000)
    z[(abs(x - 0.5) < 0.05) & (abs(y) < 0.05)] += 0.05
    return np.column_stack([x, y, z])


def test_height_and_tilt_in_spite_of_a_block() -> None:
    table = fit_table(points(-0.147, np.deg2rad(0.7), np.random.default_rng(0)), SQUARE)
    assert table.height == pytest.approx(-0.147, abs=2e-4)
    assert np.rad2deg(table.tilt) == pytest.approx(0.7, abs=0.03)
    assert table.rms == pytest.approx(1e-3, rel=0.1)


def test_too_little_of_it_is_refused() -> None:
    with pytest.raises(CalibrationError, match="50 points of the table are seen"):
        fit_table(points(-0.15, 0.0, np.random.default_rng(0))[:50], SQUARE)


def test_points_go_through_the_lens() -> None:
    """Depth of points on the table, put into pixels by OpenCV, comes back to the table."""
    lens = replace(D435_720P, distortion=(0.1, -0.05, 1e-3, 0.0, 0.0))
    X = CELL.X_base_camera
    # Where each pixel's ray meets the plane, by OpenCV's iteration.
    v, u = np.mgrid[0 : lens.height, 0 : lens.width]
    pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)[:, None]
    rays = cv2.undistortPoints(pixels, lens.as_matrix(), np.array(lens.distortion))[:, 0]
    rays = np.pad(rays, ((0, 0), (0, 1)), constant_values=1.0)
    z = (SQUARE.table_z - X.translation[2]) / X.rotation.apply(rays)[:, 2]
    depth = z.reshape(lens.height, lens.width).astype(np.float32)
    depth[:, :200] = np.nan
    found = workspace_points(depth, lens, X, SQUARE)
    assert len(found) > 10_000
    np.testing.assert_allclose(found[:, 2], SQUARE.table_z, atol=1e-6)
    some = found[:: len(found) // 50]
    camera = X.inverse() @ some
    again, _ = cv2.projectPoints(
        camera, np.zeros(3), np.zeros(3), lens.as_matrix(), np.array(lens.distortion)
    )
    np.testing.assert_allclose(again % 4, np.round(again % 4), atol=0.05)  # whole fourth pixels


@pytest.mark.parametrize(
    ("height", "tilt", "said"),
    [(-0.149, 0.001, None), (-0.1444, 0.0, "seen +5.6 mm"), (-0.15, 0.02, "tilted by 1.15")],
)
def test_a_table_elsewhere_is_said(height: float, tilt: float, said: str | None) -> None:
    problem = table_problem(TablePlane(height=height, tilt=tilt, rms=1e-3), SQUARE)
    if said is None:
        assert problem is None
    else:
        assert problem is not None
        assert said in problem
