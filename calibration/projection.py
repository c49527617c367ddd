"""The measurement model of all views at once, with its analytic derivatives.

A corner p_board is seen at project(X_camera_parent @ X_parents_i @ X_parent_board @ (s p_board)).
Rotations and translations are perturbed on the right: X <- X exp(w, v), with w in radians and v
in metres along the axes of the moved frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from calibration.views import Mounting, View
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

# Columns of a Jacobian.
CAMERA, BOARD = slice(0, 6), slice(6, 12)
LENS = slice(12, 18)  # fx and fy relative to nominal, cx and cy in pixels, k1, k2
SCALE = slice(18, 19)  # of the printed board, relative
PARAMETERS = 19


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """What the views are explained by. scale: printed size over nominal size of the board."""

    X_parent_camera: Transform
    X_parent_board: Transform
    intrinsics: Intrinsics
    scale: float = 1.0

    def moved(self, step: Array) -> Estimate:
        """step: (19,) in the order of the Jacobian's columns."""
        lens = step[LENS]
        k = self.intrinsics
        k1, k2, p1, p2, k3 = k.distortion
        return Estimate(
            X_parent_camera=self.X_parent_camera @ _small(step[CAMERA]),
            X_parent_board=self.X_parent_board @ _small(step[BOARD]),
            intrinsics=replace(
                k,
                fx=k.fx * (1 + lens[0]),
                fy=k.fy * (1 + lens[1]),
                cx=k.cx + lens[2],
                cy=k.cy + lens[3],
                distortion=(k1 + lens[4], k2 + lens[5], p1, p2, k3),
            ),
            scale=self.scale * (1 + float(step[SCALE][0])),
        )


def _small(step: Array) -> Transform:
    return Transform(Rotation.from_rotvec(step[:3]), step[3:])


@dataclass(frozen=True, kw_only=True, eq=False)
class Observations:
    """Views as arrays; corners that a view did not see are padding.

    points: (V, N, 3) metres in the board's frame. pixels: (V, N, 2). seen: (V, N).
    rotations, translations: (V, 3, 3), (V, 3) of X_parents.
    """

    mounting: Mounting
    points: Array
    pixels: Array
    seen: npt.NDArray[np.bool_]
    rotations: Array
    translations: Array

    @classmethod
    def of(cls, views: Sequence[View], board_corners: Array, mounting: Mounting) -> Observations:
        """board_corners: (n, 3) metres, nominal, by corner id."""
        most = max(len(view.ids) for view in views)
        points = np.zeros((len(views), most, 3))
        pixels = np.zeros((len(views), most, 2))
        seen = np.zeros((len(views), most), bool)
        for i, view in enumerate(views):
            count = len(view.ids)
            points[i, :count] = board_corners[view.ids]
            pixels[i, :count] = view.corners
            seen[i, :count] = True
        poses = [view.X_parents(mounting) for view in views]
        return cls(
            mounting=mounting,
            points=points,
            pixels=pixels,
            seen=seen,
            rotations=np.stack([pose.rotation.as_matrix() for pose in poses]),
            translations=np.stack([pose.translation for pose in poses]),
        )

    def __len__(self) -> int:
        return len(self.points)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """(V,) numbers in a view: two for each corner seen."""
        return np.asarray(2 * self.seen.sum(axis=1), np.int64)

    def take(self, index: npt.NDArray[np.bool_] | npt.NDArray[np.int64]) -> Observations:
        return replace(
            self,
            points=self.points[index],
            pixels=self.pixels[index],
            seen=self.seen[index],
            rotations=self.rotations[index],
            translations=self.translations[index],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearised:
    """residuals: (V, 2N) pixels, predicted minus seen; zero where padded.

    jacobian: (V, 2N, 19). pose_jacobian: (V, 2N, 6), by the arm's pose error at the tool.
    """

    residuals: Array
    jacobian: Array
    pose_jacobian: Array


def linearise(estimate: Estimate, seen: Observations) -> Linearised:
    X_camera_parent = estimate.X_parent_camera.inverse()
    R_camera = X_camera_parent.rotation.as_matrix()
    R_camera_other = R_camera @ seen.rotations  # other: the board's parent frame
    p_board = estimate.scale * seen.points
    p_other = estimate.X_parent_board @ p_board
    p_parent = np.einsum("vij,vnj->vni", seen.rotations, p_other) + seen.translations[:, None]
    p_camera = X_camera_parent @ p_parent
    # Padding sits anywhere: keep it in front of the camera, and out of the sums.
    p_camera = np.where(seen.seen[..., None], p_camera, [0.0, 0.0, 1.0])

    pixels, by_point, by_lens = project(p_camera, estimate.intrinsics)
    R_camera_board = R_camera_other @ estimate.X_parent_board.rotation.as_matrix()
    moves = np.zeros((*p_camera.shape, PARAMETERS - 6))
    moves[..., 0:3] = _cross(p_camera)
    moves[..., 3:6] = -np.eye(3)
    moves[..., 6:9] = -R_camera_board[:, None] @ _cross(p_board)
    moves[..., 9:12] = R_camera_board[:, None]
    moves[..., 12] = np.einsum("vij,vnj->vni", R_camera_board, p_board)
    pose_moves = np.zeros((*p_camera.shape, 6))
    if seen.mounting is Mounting.EYE_TO_HAND:  # tool is where the board hangs
        pose_moves[..., 0:3] = -R_camera_other[:, None] @ _cross(p_other)
        pose_moves[..., 3:6] = R_camera_other[:, None]
    else:  # tool is where the camera hangs
        pose_moves[..., 0:3] = R_camera @ _cross(p_parent)
        pose_moves[..., 3:6] = -R_camera

    geometric = by_point @ moves
    jacobian = np.concatenate([geometric[..., :12], by_lens, geometric[..., 12:]], axis=-1)
    mask = seen.seen[..., None]
    views = len(seen)
    return Linearised(
        residuals=((pixels - seen.pixels) * mask).reshape(views, -1),
        jacobian=(jacobian * mask[..., None]).reshape(views, -1, PARAMETERS),
        pose_jacobian=((by_point @ pose_moves) * mask[..., None]).reshape(views, -1, 6),
    )


def project(p_camera: Array, lens: Intrinsics) -> tuple[Array, Array, Array]:
    """Pixels (..., 2), their derivatives by the point (..., 2, 3) and by the lens (..., 2, 6).

    Brown-Conrady, as OpenCV's calib3d documents it. Points behind the camera are kept at 1 mm
    before it: they are far from what was seen, and stay finite.
    """
    k1, k2, p1, p2, k3 = lens.distortion
    z = np.maximum(p_camera[..., 2], 1e-3)
    x, y = p_camera[..., 0] / z, p_camera[..., 1] / z
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))  # d radial / d x = slope * x
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixels = np.stack([lens.fx * xd + lens.cx, lens.fy * yd + lens.cy], axis=-1)

    cross = slope * x * y + 2 * p1 * x + 2 * p2 * y
    dxd = np.stack([radial + slope * x * x + 2 * p1 * y + 6 * p2 * x, cross], axis=-1)
    dyd = np.stack([cross, radial + slope * y * y + 6 * p1 * y + 2 * p2 * x], axis=-1)
    by_plane = np.stack([lens.fx * dxd, lens.fy * dyd], axis=-2)
    zero = np.zeros_like(x)
    plane_by_point = np.stack(
        [
            np.stack([1 / z, zero, -x / z], axis=-1),
            np.stack([zero, 1 / z, -y / z], axis=-1),
        ],
        axis=-2,
    )
    by_lens = np.zeros((*x.shape, 2, 6))
    by_lens[..., 0, 0] = lens.fx * xd
    by_lens[..., 1, 1] = lens.fy * yd
    by_lens[..., 0, 2] = by_lens[..., 1, 3] = 1
    by_lens[..., 0, 4], by_lens[..., 1, 4] = lens.fx * x * r2, lens.fy * y * r2
    by_lens[..., 0, 5], by_lens[..., 1, 5] = lens.fx * x * r2**2, lens.fy * y * r2**2
    return pixels, by_plane @ plane_by_point, by_lens


def _cross(p: Array) -> Array:
    """(..., 3, 3) matrix of the cross product p x."""
    x, y, z = np.moveaxis(p, -1, 0)
    zero = np.zeros_like(x)
    return np.stack(
        [
            np.stack([zero, -z, y], axis=-1),
            np.stack([z, zero, -x], axis=-1),
            np.stack([-y, x, zero], axis=-1),
        ],
        axis=-2,
    )
