"""Scenes whose depth has a formula, and the cameras that look at them. No renderer involved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics, RgbdFrame

HD = Intrinsics(width=1280, height=720, fx=920.5, fy=919.0, cx=643.2, cy=356.7)
VGA = Intrinsics(width=640, height=480, fx=613.7, fy=612.7, cx=322.1, cy=237.5)
BACKGROUND_RGB = (200, 180, 150)
BOX_RGB = (10, 120, 240)


@dataclass(frozen=True, kw_only=True)
class Plane:
    """normal . p = offset, in base."""

    normal: tuple[float, float, float]
    offset: float

    def depth(self, rays: Array, eye: Array) -> Array:
        """Along rays (..., 3) in base whose length is one metre of depth."""
        normal = np.array(self.normal)
        with np.errstate(divide="ignore"):
            depth = (self.offset - normal @ eye) / (rays @ normal)
        return np.where(depth > 0, depth, np.nan)


@dataclass(frozen=True, kw_only=True)
class Box:
    """size: (3,) m, around the origin of its frame."""

    size: tuple[float, float, float]
    X_base_box: Transform

    def depth(self, rays: Array, eye: Array) -> Array:
        """Slab method, nan where missed."""
        X_box_base = self.X_base_box.inverse()
        start = X_box_base @ eye
        along = rays @ X_box_base.rotation.as_matrix().T
        half = np.array(self.size) / 2
        with np.errstate(divide="ignore", invalid="ignore"):
            walls = np.stack([(-half - start) / along, (half - start) / along])
        entry, leave = walls.min(axis=0).max(axis=-1), walls.max(axis=0).min(axis=-1)
        return np.where((entry < leave) & (entry > 0), entry, np.nan)

    def height_above(self, x: Array, y: Array) -> Array:
        """z of its upper side at x, y in base, nan beside it."""
        down = np.array([0.0, 0.0, -1.0])
        eyes = np.stack([x, y, np.full(np.shape(x), 10.0)], axis=-1)
        flat = [float(self.depth(down, eye)) for eye in eyes.reshape(-1, 3)]
        return 10.0 - np.array(flat).reshape(np.shape(x))


def look(
    plane: Plane | None, box: Box | None, camera: Intrinsics, X_base_camera: Transform
) -> RgbdFrame:
    """The noiseless frame of a pinhole without distortion."""
    row, col = np.mgrid[: camera.height, : camera.width]
    rays = np.stack(
        [(col - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, np.ones(row.shape)], axis=-1
    )
    return look_along(rays, plane, box, camera, X_base_camera)


def look_along(
    rays_camera: Array,
    plane: Plane | None,
    box: Box | None,
    camera: Intrinsics,
    X_base_camera: Transform,
) -> RgbdFrame:
    """The same along given rays (H, W, 3) with z = 1."""
    rays = rays_camera @ X_base_camera.rotation.as_matrix().T
    eye = X_base_camera.translation
    nowhere = np.full(rays.shape[:2], np.inf)
    behind = nowhere if plane is None else np.nan_to_num(plane.depth(rays, eye), nan=np.inf)
    before = nowhere if box is None else np.nan_to_num(box.depth(rays, eye), nan=np.inf)
    color = np.where((before < behind)[..., None], BOX_RGB, BACKGROUND_RGB).astype(np.uint8)
    depth = np.minimum(before, behind)
    return frame_of(np.where(np.isinf(depth), np.nan, depth), camera, color)


def frame_of(
    depth: Array, camera: Intrinsics, color: npt.NDArray[np.uint8] | None = None
) -> RgbdFrame:
    if color is None:
        color = np.zeros((*depth.shape, 3), np.uint8)
    return RgbdFrame(
        color=color,
        depth=depth.astype(np.float32),
        intrinsics=camera,
        captured_at=0.0,
        sequence=7,
        serial="closed form",
    )


def looking_at(eye: tuple[float, float, float], at: tuple[float, float, float]) -> Transform:
    """Pose of a camera whose picture has base z upwards; not for looking straight down."""
    z = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return Transform(Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=1)), np.array(eye))
