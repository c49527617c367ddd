"""An RGB-D frame and the camera's pose -> the heightmap that policies see."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from policies.heightmap import PIXEL, SIZE, Heightmap, Workspace
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.compiled import compiled
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import RgbdFrame


def workspace_of(config: CellConfig) -> Workspace:
    """The square of the cell file, as heightmaps name it."""
    x, y = config.workspace.center
    half = SIZE * PIXEL / 2
    return Workspace(x_min=x - half, y_min=y - half, table_z=config.workspace.table_z)


def build_heightmap(
    frame: RgbdFrame, X_base_camera: Transform, workspace: Workspace
) -> Heightmap:
    """Highest point of each pixel of the map, with its colour; nan where none fell."""
    i = frame.intrinsics
    height = np.full((SIZE, SIZE), np.nan, np.float32)
    winner = np.full((SIZE, SIZE), -1, np.int32)
    _scatter(
        frame.depth,
        X_base_camera.as_matrix().astype(np.float32),
        np.float32([i.fx, i.fy, i.cx, i.cy]),
        np.float32([workspace.x_max, workspace.y_max, workspace.table_z]),
        height,
        winner,
    )
    color = np.zeros((SIZE, SIZE, 3), np.uint8)
    seen = winner >= 0
    color[seen] = frame.color.reshape(-1, 3)[winner[seen]]
    for _ in range(2):
        _fill(height, color)
    return Heightmap(workspace=workspace, color=color, height=height)


@compiled
def _scatter(depth, X, pinhole, corner, height, winner):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = pinhole
    rows, cols = depth.shape
    for v in range(rows):
        yv = (v - cy) / fy
        for u in range(cols):
            d = depth[v, u]
            if not d > 0:
                continue
            xu = (u - cx) / fx
            x = d * (X[0, 0] * xu + X[0, 1] * yv + X[0, 2]) + X[0, 3]
            y = d * (X[1, 0] * xu + X[1, 1] * yv + X[1, 2]) + X[1, 3]
            r = np.floor((corner[0] - x) * np.float32(500))
            c = np.floor((corner[1] - y) * np.float32(500))
            if r >= 0 and c >= 0 and r < 224 and c < 224:
                z = d * (X[2, 0] * xu + X[2, 1] * yv + X[2, 2]) + X[2, 3] - corner[2]
                if not height[int(r), int(c)] >= z:
                    height[int(r), int(c)] = z
                    winner[int(r), int(c)] = v * cols + u


def _fill(height: npt.NDArray[np.float32], color: npt.NDArray[np.uint8]) -> None:
    for axis in (0, 1):
        before, after = np.roll(height, 1, axis), np.roll(height, -1, axis)
        gap = np.isnan(height) & (np.abs(before - after) < 0.005)
        height[gap] = ((before + after) / 2)[gap]
        color[gap] = np.roll(color, 1, axis)[gap]
