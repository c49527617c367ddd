"""Whether two pads that close hold what is between them, or squeeze it out: force closure.

Seen from above, each pad meets a face. Pads hold what they close on when both faces lie within
the friction angle of them; where the faces make a wedge of more than twice that angle, as at the
corner of a block, it slips out (Nguyen, "Constructing Force-Closure Grasps", 1988).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from policies.gripper import FLAT, MIN_GRASP_DEPTH, OPEN_WIDTH, PAD_WIDTH
from policies.heightmap import PIXEL, RIM, WIDE, Heightmap
from policies.policy import HALF_TURN, ROTATIONS

MAX_WEDGE = np.radians(75)  # twice the friction angle of rubber on wood, with what pixels err

_ALONG = np.arange(-OPEN_WIDTH / 2, OPEN_WIDTH / 2, PIXEL)
_ACROSS = np.linspace(-1, 1, 6) * (PAD_WIDTH - PIXEL) / 2  # less what a pixel may err

Mask = npt.NDArray[np.bool_]
Array = npt.NDArray[np.float64]


def holding(heightmap: Heightmap, grasps: Mask, *, max_wedge: float = MAX_WEDGE) -> Mask:
    """(8, 224, 224): those of `grasps` whose pads meet no wedge (radians) that would slip out. The
    faces are the outlines at the depth that the fingers reach at least."""
    height = np.nan_to_num(heightmap.wide).ravel()
    held = np.zeros_like(grasps)
    for rotation in range(HALF_TURN):
        rows, cols = np.nonzero(grasps[rotation])
        down, right = _between_the_pads(rotation * 2 * np.pi / ROTATIONS)
        at = (rows + RIM) * WIDE + cols + RIM
        around = height[at[:, None, None] + (down * WIDE + right)]
        level = np.maximum(height[at] - MIN_GRASP_DEPTH, FLAT)
        held[rotation, rows, cols] = _wedge(around > level[:, None, None]) <= max_wedge
    return held


def _between_the_pads(yaw: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rows and columns (6, n), from a grasp's own, of lines along its yaw from pad to pad."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = c * _ALONG - s * _ACROSS[:, None], s * _ALONG + c * _ACROSS[:, None]
    return np.rint(-x / PIXEL).astype(np.intp), np.rint(-y / PIXEL).astype(np.intp)


def _wedge(solid: Mask) -> Array:
    """(k,) radians between the two faces of what stands between the pads, (k, 6, n)."""
    met = np.asarray(solid.any(axis=2))
    first, last = solid.argmax(axis=2), solid[:, :, ::-1].argmax(axis=2)
    wedge: Array = np.abs(_turned(_ALONG[first], met) - _turned(_ALONG[::-1][last], met))
    return wedge


def _turned(face: Array, met: Mask) -> Array:
    """(k,) radians that a face is turned from a pad: the line of least squares through where it
    was met, (k, 6) metres along the yaw."""
    weight = met / np.maximum(met.sum(axis=1, keepdims=True), 1)
    across = _ACROSS - (weight * _ACROSS).sum(axis=1, keepdims=True)
    spread = (weight * across**2).sum(axis=1)
    slope = (weight * across * face).sum(axis=1) / np.where(spread > 0, spread, 1)
    turned: Array = np.arctan(slope)
    return turned
