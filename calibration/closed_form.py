"""Where to start: both unknown poses from pose pairs, in closed form, by consensus.

For each view X_parents_i @ X_parent_board = X_parent_camera @ X_camera_board_i. Rotations by the
singular vectors of the summed Kronecker products (Shah, "Solving the robot-world/hand-eye
calibration problem using the Kronecker product", 2013), translations by least squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from calibration.views import View
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

SAMPLE = 4  # views that a guess is made from
GUESSES = 60  # 0.8^4 = 0.41 of the samples are clean with 20 % bad views
TRANSLATION_SCALE, ROTATION_SCALE = 3e-3, 6e-3  # m, rad: what a single board pose errs by


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """misfit: (V,) disagreement of each pair, 1 is usual, above 9 is not this solution's."""

    X_parent_camera: Transform
    X_parent_board: Transform
    misfit: Array

    @property
    def score(self) -> float:
        """Smaller is better; a pair that does not fit counts 9, however bad."""
        return float(np.minimum(self.misfit, 9.0).mean())

    @property
    def agree(self) -> float:
        """Share of the pairs that fit."""
        return float((self.misfit < 9.0).mean())


def board_pose(view: View, board_corners: Array, intrinsics: Intrinsics) -> Transform:
    """X_camera_board from one picture."""
    points = board_corners[view.ids]
    K, distortion = intrinsics.as_matrix(), np.array(intrinsics.distortion)
    _, rotation, translation = cv2.solvePnP(
        points, view.corners, K, distortion, flags=cv2.SOLVEPNP_IPPE
    )
    rotation, translation = cv2.solvePnPRefineLM(
        points, view.corners, K, distortion, rotation, translation
    )
    return Transform.from_rotation_vector(np.concatenate([translation, rotation]).ravel())


def start(X_parents: Sequence[Transform], X_camera_boards: Sequence[Transform]) -> Start:
    """The solution that most pairs agree on. Needs three pairs or more."""
    A = np.stack([X.as_matrix() for X in X_parents])
    B = np.stack([X.as_matrix() for X in X_camera_boards])
    rng = np.random.default_rng(0)  # the same views give the same answer
    views = len(A)
    samples: list[npt.NDArray[np.int64]] = [np.arange(views)]
    if views > SAMPLE:
        samples += [rng.choice(views, SAMPLE, replace=False) for _ in range(GUESSES)]
    best = min((_judged(A, B, sample) for sample in samples), key=lambda s: s.score)
    for _ in range(3):
        agreeing = np.flatnonzero(best.misfit < 9.0)
        if len(agreeing) < 3:
            break
        again = _judged(A, B, agreeing)
        if again.score >= best.score:
            break
        best = again
    return best


def _judged(A: Array, B: Array, sample: npt.NDArray[np.int64]) -> Start:
    X, Y = _solve_pairs(A[sample], B[sample])
    left, right = A @ Y, X @ B
    offset = np.linalg.norm(left[:, :3, 3] - right[:, :3, 3], axis=1)
    turn = Rotation.from_matrix(np.swapaxes(left[:, :3, :3], 1, 2) @ right[:, :3, :3]).magnitude()
    misfit = (offset / TRANSLATION_SCALE) ** 2 + (turn / ROTATION_SCALE) ** 2
    return Start(
        X_parent_camera=Transform.from_matrix(X),
        X_parent_board=Transform.from_matrix(Y),
        misfit=np.asarray(misfit, np.float64),
    )


def _solve_pairs(A: Array, B: Array) -> tuple[Array, Array]:
    """X (4, 4) and Y (4, 4) with A_i Y = X B_i; A and B are (V, 4, 4)."""
    RA, RB = A[:, :3, :3], B[:, :3, :3]
    kronecker = np.einsum("vij,vkl->ikjl", RA, RB).reshape(9, 9)  # vec(RX) ~ K vec(RY), row-major
    u, _, vt = np.linalg.svd(kronecker)
    RX, RY = _nearest_rotation(u[:, 0]), _nearest_rotation(vt[0])
    # RA tY - tX = RX tB - tA
    left = np.concatenate([np.broadcast_to(-np.eye(3), RA.shape), RA], axis=2).reshape(-1, 6)
    right = (B[:, :3, 3] @ RX.T - A[:, :3, 3]).reshape(-1)
    t = np.linalg.lstsq(left, right, rcond=None)[0]
    X, Y = np.eye(4), np.eye(4)
    X[:3, :3], X[:3, 3], Y[:3, :3], Y[:3, 3] = RX, t[:3], RY, t[3:]
    return X, Y


def _nearest_rotation(vector: Array) -> Array:
    m = vector.reshape(3, 3)
    m = m * np.sign(np.linalg.det(m))
    u, _, vt = np.linalg.svd(m)
    return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt, np.float64)
