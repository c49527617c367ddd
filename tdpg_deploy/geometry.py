"""Rigid transforms. `X_a_b` is the pose of frame b in frame a, so inner names cancel:

X_base_board = X_base_camera @ X_camera_board
p_base = X_base_camera @ p_camera
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Transform:
    """A rotation, then a translation (3,) in metres. Immutable."""

    rotation: Rotation
    translation: Array

    def __post_init__(self) -> None:
        translation = np.array(self.translation, np.float64)
        if translation.shape != (3,) or not np.isfinite(translation).all():
            raise ValueError(f"translation must be three finite metres, got {self.translation!r}")
        translation.setflags(write=False)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def identity(cls) -> Transform:
        return cls(Rotation.identity(), np.zeros(3))

    @classmethod
    def from_matrix(cls, matrix: npt.ArrayLike) -> Transform:
        """(4, 4) homogeneous matrix; its rotation must be orthonormal within 1e-4."""
        m = np.asarray(matrix, np.float64)
        if m.shape != (4, 4) or not np.isfinite(m).all():
            raise ValueError(f"expected a finite (4, 4) matrix, got {m!r}")
        r = m[:3, :3]
        if np.abs(r @ r.T - np.eye(3)).max() > 1e-4 or np.linalg.det(r) < 0:
            raise ValueError(f"not a rotation: {r!r}")
        return cls(Rotation.from_matrix(r), m[:3, 3])

    @classmethod
    def from_quaternion(cls, translation: npt.ArrayLike, xyzw: npt.ArrayLike) -> Transform:
        """Quaternion scalar last, any non-zero norm."""
        return cls(Rotation.from_quat(np.asarray(xyzw, np.float64)), np.asarray(translation))

    @classmethod
    def from_rotation_vector(cls, pose: npt.ArrayLike) -> Transform:
        """UR's pose: x, y, z in metres and a rotation vector in radians, (6,)."""
        p = np.asarray(pose, np.float64)
        return cls(Rotation.from_rotvec(p[3:]), p[:3])

    def as_matrix(self) -> Array:
        m = np.eye(4)
        m[:3, :3] = self.rotation.as_matrix()
        m[:3, 3] = self.translation
        return m

    def as_quaternion(self) -> Array:
        """(4,) x, y, z, w with w >= 0."""
        return np.asarray(self.rotation.as_quat(canonical=True), np.float64)

    def as_rotation_vector(self) -> Array:
        """UR's pose (6,): x, y, z in metres and a rotation vector in radians."""
        return np.concatenate([self.translation, self.rotation.as_rotvec()])

    def inverse(self) -> Transform:
        inverse = self.rotation.inv()
        return Transform(inverse, -(inverse.as_matrix() @ self.translation))

    @overload
    def __matmul__(self, other: Transform) -> Transform: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: Transform | Array) -> Transform | Array:
        """Chain with a transform, or move points of shape (..., 3)."""
        if isinstance(other, Transform):
            return Transform(
                self.rotation * other.rotation,
                self.rotation.as_matrix() @ other.translation + self.translation,
            )
        points = np.asarray(other, np.float64)
        return points @ self.rotation.as_matrix().T + self.translation

    def distance(self, other: Transform) -> tuple[float, float]:
        """Metres and radians between two poses of one frame."""
        angle = float((self.rotation.inv() * other.rotation).magnitude())
        return float(np.linalg.norm(self.translation - other.translation)), angle


def top_down(x: float, y: float, z: float, yaw: float) -> Transform:
    """X_base_tool of a tool that points straight down, its x axis turned to `yaw`."""
    return Transform(
        Rotation.from_euler("z", yaw) * Rotation.from_euler("x", np.pi), np.array([x, y, z])
    )
