"""An RGB-D frame and the camera's pose -> the heightmap that policies see."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from policies.heightmap import INSIDE, PIXEL, RIM, WIDE, Heightmap, Workspace
from tdpg_deploy.compiled import compiled
from tdpg_deploy.errors import FrameError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Intrinsics, RgbdFrame

ONE_SURFACE = 0.004  # m; a filled gap is the mean of two that differ by less: 2 mm at most

Floats = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int32]


def build_heightmap(
    frame: RgbdFrame,
    X_base_camera: Transform,
    workspace: Workspace,
    *,
    goal_pixels: npt.NDArray[np.bool_] | None = None,
) -> Heightmap:
    """The highest point seen in each pixel of the map, with its colour; nan where none was. Around
    it, heights alone.

    Gaps of one pixel between samples of one surface are filled; what an edge hides stays
    unknown. goal_pixels: (H, W) of the frame, where it shows the object to fetch.
    Raises FrameError if the frame's arrays do not fit its intrinsics.
    """
    _validate(frame, goal_pixels)
    # Row, column (in pixels of the map) and height of a point z * (ray_x, ray_y, 1).
    to_map = np.diag([-1 / PIXEL, -1 / PIXEL, 1.0])
    rim = RIM * PIXEL
    corner = np.array([workspace.x_max + rim, workspace.y_max + rim, workspace.table_z])
    wide, source = _project(
        np.ascontiguousarray(frame.depth),
        *_rays(frame.intrinsics),
        (to_map @ X_base_camera.rotation.as_matrix()).astype(np.float32),
        (to_map @ (X_base_camera.translation - corner)).astype(np.float32),
    )
    wide, source = _fill(wide, source)
    height, source = wide[INSIDE, INSIDE].copy(), source[INSIDE, INSIDE]
    wide[INSIDE, INSIDE] = np.nan
    seen = source >= 0
    color = frame.color.reshape(-1, 3)[source]
    color[~seen] = 0
    goal = None if goal_pixels is None else goal_pixels.reshape(-1)[source] & seen
    return Heightmap(workspace=workspace, color=color, height=height, goal=goal, rim=wide)


def _validate(frame: RgbdFrame, goal_pixels: npt.NDArray[np.bool_] | None) -> None:
    shape = (frame.intrinsics.height, frame.intrinsics.width)
    arrays: list[tuple[str, npt.NDArray[np.generic], tuple[int, ...], type[np.generic]]] = [
        ("depth", frame.depth, shape, np.float32),
        ("color", frame.color, (*shape, 3), np.uint8),
    ]
    if goal_pixels is not None:
        arrays.append(("goal_pixels", goal_pixels, shape, np.bool_))
    for name, array, expected, dtype in arrays:
        if array.shape != expected or array.dtype != dtype:
            raise FrameError(
                f"frame {frame.sequence} of camera {frame.serial}: {name} is {array.shape} "
                f"{array.dtype}, its intrinsics ask for {expected} {np.dtype(dtype)}"
            )


@lru_cache(maxsize=4)
def _rays(intrinsics: Intrinsics) -> tuple[Floats, Floats]:
    """(H, W) each: x / z and y / z of the ray through each pixel's centre, undistorted."""
    k = intrinsics
    row, col = np.mgrid[: k.height, : k.width].astype(np.float64)
    if not any(k.distortion):
        rays = np.stack([(col - k.cx) / k.fx, (row - k.cy) / k.fy])
    else:
        import cv2

        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)  # eps in pixels
        pixels = np.stack([col.ravel(), row.ravel()], axis=1)[:, None]
        points = cv2.undistortPointsIter(
            pixels, k.as_matrix(), np.array(k.distortion), np.eye(3), np.eye(3), until
        )
        rays = points.reshape(k.height, k.width, 2).transpose(2, 0, 1)
    x, y = np.ascontiguousarray(rays, np.float32)
    return x, y


@compiled
def _project(
    depth: Floats, ray_x: Floats, ray_y: Floats, R: Floats, t: Floats
) -> tuple[Floats, Indices]:
    """(304, 304) height of the highest point of each pixel (nan where none) and the flat index
    of the frame's pixel that it came from (-1)."""
    rows, columns = depth.shape
    size = np.float32(WIDE)
    height = np.full((WIDE, WIDE), np.nan, np.float32)
    source = np.full((WIDE, WIDE), -1, np.int32)
    flat_height, flat_source = height.ravel(), source.ravel()
    place = np.empty(columns, np.int32)
    risen = np.empty(columns, np.float32)
    for row in range(rows):
        for col in range(columns):  # apart from the scattering loop: this one runs in SIMD
            x, y, z = ray_x[row, col], ray_y[row, col], depth[row, col]
            i = t[0] + z * (R[0, 0] * x + R[0, 1] * y + R[0, 2])
            j = t[1] + z * (R[1, 0] * x + R[1, 1] * y + R[1, 2])
            risen[col] = t[2] + z * (R[2, 0] * x + R[2, 1] * y + R[2, 2])
            inside = (z > 0) & (i >= 0) & (i < size) & (j >= 0) & (j < size)  # False for nan
            place[col] = np.int32(i) * WIDE + np.int32(j) if inside else -1
        for col in range(columns):
            at = place[col]
            if at >= 0 and not flat_height[at] >= risen[col]:
                flat_height[at] = risen[col]
                flat_source[at] = row * columns + col
    return height, source


@compiled
def _fill(height: Floats, source: Indices) -> tuple[Floats, Indices]:
    """Close unseen pixels between two seen ones, opposite of each other, of one surface.

    Of several such pairs the one that agrees best counts.
    """
    filled, origin = height.copy(), source.copy()
    for row in range(1, WIDE - 1):
        for col in range(1, WIDE - 1):
            if source[row, col] >= 0:
                continue
            best = np.float32(ONE_SURFACE)
            for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
                one, other = height[row - down, col - right], height[row + down, col + right]
                difference = abs(one - other)
                if difference < best:  # False for nan
                    best = difference
                    filled[row, col] = (one + other) / 2
                    origin[row, col] = source[row - down, col - right]
    return filled, origin
