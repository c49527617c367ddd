"""Kinematics of a UR arm in its `base` frame, for a tool fixed to the flange. Pure, in batches.

The closed form is written out here because `ur_analytic_ik` (the tests' reference) loses
branches and writes to stdout near a wrist 3 of 0, where this cell parks its arm
(Victorlouisdg/ur-analytic-ik, issue 5).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tdpg_deploy.geometry import Array, Transform


@dataclass(frozen=True, kw_only=True)
class DhParameters:
    """Denavit-Hartenberg lengths of a UR arm, m; its twists are those of every UR arm."""

    name: str
    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float

    @property
    def joints(self) -> tuple[tuple[float, float, float], ...]:
        """d (m), a (m) and alpha (rad) of each joint."""
        return (
            (self.d1, 0.0, np.pi / 2),
            (0.0, self.a2, 0.0),
            (0.0, self.a3, 0.0),
            (self.d4, 0.0, np.pi / 2),
            (self.d5, 0.0, -np.pi / 2),
            (self.d6, 0.0, 0.0),
        )


# Universal Robots, "DH Parameters for calculations of kinematics and dynamics".
UR5 = DhParameters(
    name="UR5", d1=0.089159, a2=-0.425, a3=-0.39225, d4=0.10915, d5=0.09465, d6=0.0823
)
UR5E = DhParameters(name="UR5e", d1=0.1625, a2=-0.425, a3=-0.3922, d4=0.1333, d5=0.0997, d6=0.0996)
MODELS: Mapping[str, DhParameters] = {"ur5": UR5, "ur5e": UR5E}  # by the cell file's arm.model

_SHOULDER, _WRIST, _ELBOW = np.array(list(itertools.product((1, -1), repeat=3))).T  # branches


def forward(dh: DhParameters, q: npt.ArrayLike, X_flange_tool: Transform) -> Transform:
    """X_base_tool at joint positions q (6,) rad."""
    return Transform.from_matrix(forward_batch(dh, q) @ X_flange_tool.as_matrix())


def forward_batch(dh: DhParameters, q: npt.ArrayLike) -> Array:
    """X_base_flange as matrices (..., 4, 4) at q (..., 6) rad."""
    q = np.asarray(q, np.float64)
    X: Array = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
    for i, (d, a, alpha) in enumerate(dh.joints):
        c, s, ca, sa = np.cos(q[..., i]), np.sin(q[..., i]), np.cos(alpha), np.sin(alpha)
        link = np.zeros((*q.shape[:-1], 4, 4))
        link[..., 0, 0], link[..., 0, 1], link[..., 0, 2], link[..., 0, 3] = (
            c,
            -s * ca,
            s * sa,
            a * c,
        )
        link[..., 1, 0], link[..., 1, 1], link[..., 1, 2], link[..., 1, 3] = (
            s,
            c * ca,
            -c * sa,
            a * s,
        )
        link[..., 2, 1], link[..., 2, 2], link[..., 2, 3] = sa, ca, d
        link[..., 3, 3] = 1.0
        X = X @ link
    return X


def inverse(dh: DhParameters, X_base_tool: Transform, X_flange_tool: Transform) -> Array:
    """All branches (n, 6) rad, each angle within [-pi, pi]; (0, 6) when out of reach."""
    branches = inverse_batch(dh, X_base_tool.as_matrix() @ X_flange_tool.inverse().as_matrix())
    reached: Array = branches[np.isfinite(branches).all(axis=-1)]
    return reached


def inverse_batch(dh: DhParameters, X_base_flange: Array) -> Array:
    """Eight branches (..., 8, 6) rad for poses (..., 4, 4); nan for those out of reach.

    Branches are shoulder x wrist x elbow. Wrist 3 is 0 where it is free (sin(wrist 2) = 0).
    """
    R, p = X_base_flange[..., :3, :3], X_base_flange[..., :3, 3]

    # Wrist 1..3's offset d4 stands square on the plane of the arm, which turns by q1.
    p5 = p - dh.d6 * R[..., :, 2]
    opening = _arccos(dh.d4 / np.maximum(np.hypot(p5[..., 0], p5[..., 1]), 1e-12))
    azimuth = np.arctan2(p5[..., 1], p5[..., 0])
    q1 = azimuth[..., None] + np.pi / 2 + _SHOULDER * opening[..., None]
    c1, s1 = np.cos(q1), np.sin(q1)

    # Axis z1 = (s1, -c1, 0) seen in the flange's frame gives wrist 2 and wrist 3.
    z1 = s1[..., None] * R[..., None, 0, :] - c1[..., None] * R[..., None, 1, :]
    s5 = _WRIST * np.hypot(z1[..., 0], z1[..., 1])
    q5 = np.arctan2(s5, z1[..., 2])
    q6 = np.where(np.abs(s5) > 1e-9, np.arctan2(-_WRIST * z1[..., 1], _WRIST * z1[..., 0]), 0.0)

    # What is left is planar, in the radial direction x1 = (c1, s1, 0) and up.
    y5 = np.sin(q6)[..., None] * R[..., None, :, 0] + np.cos(q6)[..., None] * R[..., None, :, 1]
    q234 = np.arctan2(-(c1 * y5[..., 0] + s1 * y5[..., 1]), y5[..., 2])
    x = c1 * p5[..., None, 0] + s1 * p5[..., None, 1] - dh.d5 * np.sin(q234)
    y = p5[..., None, 2] - dh.d1 + dh.d5 * np.cos(q234)
    q3 = _ELBOW * _arccos((x**2 + y**2 - dh.a2**2 - dh.a3**2) / (2 * dh.a2 * dh.a3))
    q2 = np.arctan2(y, x) - np.arctan2(dh.a3 * np.sin(q3), dh.a2 + dh.a3 * np.cos(q3))
    return _wrapped(np.stack([q1, q2, q3, q234 - q2 - q3, q5, q6], axis=-1))


def _arccos(cosine: Array) -> Array:
    """nan out of reach; a stretched arm stays within reach in spite of rounding."""
    return np.where(np.abs(cosine) <= 1 + 1e-9, np.arccos(np.clip(cosine, -1, 1)), np.nan)


def _wrapped(angle: Array) -> Array:
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


def branch_of(dh: DhParameters, q: Array) -> int:
    """Which of the eight branches of `inverse_batch` the arm is in at q (6,) rad."""
    branches = inverse_batch(dh, forward_batch(dh, q))
    return int(np.nanargmin(np.abs(_wrapped(branches - q)).max(axis=-1)))


def nearest(branches: Array, q: Array, joint_range: tuple[float, float]) -> Array | None:
    """The branch of (n, 6), each joint unwound by whole turns to within `joint_range`, whose
    most moved joint is closest to q (6,) rad; None when there is none. Branches of nan are
    passed over."""
    low, high = joint_range
    branches = branches[np.isfinite(branches).all(axis=-1)]
    unwound = q + _wrapped(branches - q)
    unwound += 2 * np.pi * ((unwound < low).astype(int) - (unwound > high).astype(int))
    unwound = unwound[((unwound >= low) & (unwound <= high)).all(axis=-1)]
    if not len(unwound):
        return None
    best: Array = unwound[np.abs(unwound - q).max(axis=-1).argmin()]
    return best


def elbow_height(dh: DhParameters, q: npt.ArrayLike) -> Array:
    """Height (...) of the elbow's axis in base, m, at q (..., 6) rad."""
    height: Array = dh.d1 + dh.a2 * np.sin(np.asarray(q, np.float64)[..., 1])
    return height
