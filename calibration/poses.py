"""Where to put the arm next: the reachable pose that makes the workspace error smallest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.projection import CAMERA, Estimate, Observations, project
from calibration.refine import Noise, view_information
from calibration.views import Mounting, PoseNoise, View
from tdpg_deploy.geometry import Array, Transform

# Joints (6,) for X_base_tool that the arm may be sent to, or None.
Reach: TypeAlias = Callable[[Transform], Array | None]
# Whether the arm at joints (6,) stands between an eye (3,) and points (n, 3), all in base.
Hides: TypeAlias = Callable[[Array, Array, Array], bool]

DEPTHS = (0.35, 0.95)  # m, where a D435 is sharp and measures depth
LEAST_SQUARE = 28.0  # px across, so that the cells of its marker are 3 px
TILT, SPIN = np.deg2rad(35), np.deg2rad(50)
CLEARANCE = 0.06  # m between the held board and the table
EDGE = 20.0  # px that the whole board stays inside the picture
BEFORE = np.repeat([0.1, 0.05, 0.1, 0.05], 3)  # sd of both first guesses: rad, m, rad, m
EXPECTED_NOISE = 0.1  # px; what D435 pictures of a still board show, with a margin


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """q: (6,) rad, as `reach` gave them. X_camera_board: where the board should then be seen."""

    q: Array
    X_base_tool: Transform
    X_camera_board: Transform


def candidates(
    guess: Estimate,
    mounting: Mounting,
    board_corners: Array,
    reach: Reach,
    hides: Hides,
    table_z: float,
    rng: np.random.Generator,
    count: int = 60,
) -> list[Candidate]:
    """Reachable poses, drawn at random, that show the whole board where `guess` is right.

    table_z: metres in base; a held board stays clear of it.
    """
    found: list[Candidate] = []
    for X_camera_board in _draw(guess, board_corners, rng, 60 * count):
        if len(found) == count:
            break
        X_parents = guess.X_parent_camera @ X_camera_board @ guess.X_parent_board.inverse()
        if mounting is Mounting.EYE_IN_HAND:
            X_base_tool = X_parents.inverse()
            q = reach(X_base_tool)
            if q is None:
                continue
        else:
            X_base_tool = X_parents
            p_base = X_base_tool @ (guess.X_parent_board @ board_corners)
            if p_base[:, 2].min() < table_z + CLEARANCE:
                continue
            q = reach(X_base_tool)
            if q is None or hides(q, guess.X_parent_camera.translation, p_base):
                continue
        found.append(Candidate(q=q, X_base_tool=X_base_tool, X_camera_board=X_camera_board))
    return found


def _draw(
    guess: Estimate, board_corners: Array, rng: np.random.Generator, tries: int
) -> Iterator[Transform]:
    """X_camera_board all over the frustum, of `tries` those that cut nothing of the board off."""
    lens = guess.intrinsics
    direction, lean = rng.uniform(0, 2 * np.pi, tries), rng.uniform(0, TILT, tries)
    axis = np.stack([np.cos(direction), np.sin(direction), np.zeros(tries)], axis=1)
    spin = Rotation.from_rotvec(rng.uniform(-SPIN, SPIN, tries)[:, None] * [0.0, 0.0, 1.0])
    rotations = Rotation.from_rotvec(lean[:, None] * axis) * spin
    u, v = rng.uniform(0.1, 0.9, (2, tries))
    across, _ = _extent(board_corners)
    columns = len(np.unique(board_corners[:, 0]))
    square = float(np.ptp(across)) / (columns - 1)
    farthest = min(DEPTHS[1], lens.fx * square / LEAST_SQUARE)
    ray = [(u * lens.width - lens.cx) / lens.fx, (v * lens.height - lens.cy) / lens.fy]
    middles = (
        np.stack([*ray, np.ones(tries)], axis=1)
        * rng.uniform(DEPTHS[0], max(DEPTHS[0], farthest), tries)[:, None]
    )
    translations = middles - rotations.apply(board_corners.mean(axis=0))
    outline = np.array([[x, y, 0.0] for x, y in product(*_extent(board_corners))])
    p_camera = np.einsum("tij,cj->tci", rotations.as_matrix(), outline) + translations[:, None]
    pixels = project(p_camera, lens)[0]
    inside = (pixels > EDGE) & (pixels < [lens.width - EDGE, lens.height - EDGE])
    for index in np.flatnonzero(inside.all(axis=(1, 2))):
        yield Transform(rotations[index], translations[index])


def _extent(board_corners: Array) -> Array:
    """(2, 2) least and greatest x, and y."""
    return np.stack([board_corners.min(axis=0), board_corners.max(axis=0)], axis=1)[:2]


@dataclass(frozen=True, kw_only=True)
class Choice:
    """index: of the candidate to take next. deviation: metres, root mean variance over the
    workspace that is predicted with it."""

    index: int
    deviation: float


def best_next(
    poses: Sequence[Transform],
    taken: Sequence[Transform],
    guess: Estimate,
    mounting: Mounting,
    board_corners: Array,
    p_workspace: Array,
    noise: PoseNoise,
) -> Choice:
    """A-optimal: of `poses` the one that, with those `taken`, leaves the least variance of points
    of the workspace seen by the camera. p_workspace: (n, 3) in the camera's parent frame."""
    everything = [*taken, *poses]
    information = _information(everything, guess, mounting, board_corners, noise)
    known = np.diag(BEFORE**-2.0) + information[: len(taken)].sum(axis=0)
    covariances = np.linalg.inv(known + information[len(taken) :])[:, CAMERA, CAMERA]
    weight = _workspace_weight(guess.X_parent_camera, p_workspace)
    variances = np.einsum("cij,ji->c", covariances, weight)
    best = int(variances.argmin())
    return Choice(index=best, deviation=float(np.sqrt(variances[best])))


def predicted_deviation(
    taken: Sequence[Transform],
    guess: Estimate,
    mounting: Mounting,
    board_corners: Array,
    p_workspace: Array,
    noise: PoseNoise,
) -> float:
    """Metres; as in Choice, for the views taken."""
    information = _information(taken, guess, mounting, board_corners, noise).sum(axis=0)
    covariance = np.linalg.inv(np.diag(BEFORE**-2.0) + information)[CAMERA, CAMERA]
    weight = _workspace_weight(guess.X_parent_camera, p_workspace)
    return float(np.sqrt(np.einsum("ij,ji->", covariance, weight)))


def _information(
    poses: Sequence[Transform],
    guess: Estimate,
    mounting: Mounting,
    board_corners: Array,
    noise: PoseNoise,
) -> Array:
    ids = np.arange(len(board_corners))
    unseen = np.zeros((len(ids), 2))
    views = [View(name="", X_base_tool=pose, ids=ids, corners=unseen) for pose in poses]
    seen = Observations.of(views, board_corners, mounting)
    return view_information(guess, seen, Noise(pixel=EXPECTED_NOISE, pose=noise.variances()))


def _workspace_weight(X_parent_camera: Transform, p_parent: Array) -> Array:
    """(6, 6) W with mean squared error = tr(C W), C of (w, v) along the camera's axes."""
    p = X_parent_camera.inverse() @ p_parent
    J = np.zeros((len(p), 3, 6))
    J[:, :, 3:] = np.eye(3)
    x, y, z = p.T
    J[:, 0, 1], J[:, 0, 2] = z, -y
    J[:, 1, 0], J[:, 1, 2] = -z, x
    J[:, 2, 0], J[:, 2, 1] = y, -x
    return np.asarray(np.einsum("nki,nkj->ij", J, J) / len(p), np.float64)
