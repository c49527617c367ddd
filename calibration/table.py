"""The table as the calibrated camera sees it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from tdpg_deploy.cell_config import WorkspaceSection
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

EVERY = 4  # pixels; a plane needs no more
LEAST_POINTS = 100


@dataclass(frozen=True, kw_only=True)
class TablePlane:
    """height: m in base at the workspace's middle. tilt: rad from base's horizontal. rms: m."""

    height: float
    tilt: float
    rms: float


def workspace_points(
    depth: npt.NDArray[np.float32],
    lens: Intrinsics,
    X_base_camera: Transform,
    workspace: WorkspaceSection,
    *,
    every: int = EVERY,
) -> Array:
    """(n, 3) in base: what is seen within the workspace's square, of every so many-th pixel.

    depth: (H, W) metres, nan unknown, aligned to `lens`.
    """
    v, u = np.mgrid[: lens.height : every, : lens.width : every].reshape(2, -1)
    z = depth[v, u].astype(np.float64)
    u, v, z = (values[np.isfinite(z)] for values in (u, v, z))
    if not len(z):
        return np.zeros((0, 3))
    pixels = np.stack([u, v], axis=1).astype(np.float64)[:, None]
    rays = cv2.undistortPoints(pixels, lens.as_matrix(), np.array(lens.distortion))[:, 0]
    p_base = X_base_camera @ (z[:, None] * np.pad(rays, ((0, 0), (0, 1)), constant_values=1.0))
    (x0, x1), (y0, y1) = workspace.x_range, workspace.y_range
    x, y, _ = p_base.T
    return np.asarray(p_base[(x > x0) & (x < x1) & (y > y0) & (y < y1)], np.float64)


def fit_table(p_base: Array, workspace: WorkspaceSection) -> TablePlane:
    """A plane through points (n, 3) seen in the workspace; what lies on the table does not count.

    Raises CalibrationError when too little of it is seen.
    """
    points = p_base[np.isfinite(p_base).all(axis=1)]
    if len(points) < LEAST_POINTS:
        raise CalibrationError(
            f"{len(points)} points of the table are seen, {LEAST_POINTS} are needed: clear it, "
            "and check depth"
        )
    design = np.column_stack([np.ones(len(points)), points[:, :2] - workspace.center])
    kept = np.ones(len(points), bool)
    plane, off, spread = np.zeros(3), np.zeros(len(points)), 0.0
    for _ in range(5):
        plane = np.linalg.lstsq(design[kept], points[kept, 2], rcond=None)[0]
        off = points[:, 2] - design @ plane
        spread = 1.48 * float(np.median(np.abs(off[kept] - np.median(off[kept]))))
        kept = np.abs(off) < max(3 * spread, 1e-4)
    return TablePlane(
        height=float(plane[0]),
        tilt=float(np.arctan(np.hypot(plane[1], plane[2]))),
        rms=float(np.sqrt(np.mean(off[kept] ** 2))),
    )
