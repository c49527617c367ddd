"""Whether two pads that close hold what is between them, or squeeze it out: force closure.

Each pad meets a face. Pads hold what they close on when both faces lie within the friction angle
of them; where the faces make a wedge of more than twice that angle, it slips out (Nguyen,
"Constructing Force-Closure Grasps", 1988): seen from above, sideways, as at the corner of a block;
seen from the side, downwards, as from a roof or the upper half of a ball.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from policies.gripper import FLAT, GRASP_DEPTH, MIN_GRASP_DEPTH, OPEN_WIDTH, PAD_WIDTH
from policies.heightmap import PIXEL, RIM, WIDE, Heightmap
from policies.policy import HALF_TURN, ROTATIONS
from policies.standing import Map, Mask

MAX_WEDGE = np.radians(75)  # twice the friction angle of rubber on wood, with what pixels err ...
SURE_WEDGE = np.radians(60)  # ... and less what they err

OVER_TIPS = 0.006  # m over the tips where the pads meet a face: less may be noise
UP_TO = 0.016  # m that a face is followed up from there, ...
UNDER_TOP = 0.006  # ... but not this close to the top, where edges are seen as round
LEAST_RISE = 0.004  # m

Array = npt.NDArray[np.float64]

_ALONG: Array = np.arange(-OPEN_WIDTH / 2, OPEN_WIDTH / 2, PIXEL, dtype=np.float64)
_ACROSS = np.linspace(-1, 1, 6) * (PAD_WIDTH - PIXEL) / 2  # less what a pixel may err


def wedges(heightmap: Heightmap, grasps: Mask, ground: npt.ArrayLike) -> Map:
    """(8, 224, 224) radians between the faces that the pads of each of `grasps` meet; inf
    elsewhere. ground: metres above the table that keep the finger tips up, for each grasp;
    broadcasts."""
    height = np.nan_to_num(heightmap.wide).ravel()
    ground = np.broadcast_to(ground, grasps.shape)
    wedge = np.full(grasps.shape, np.inf, np.float32)
    for rotation in range(HALF_TURN):
        rows, cols = np.nonzero(grasps[rotation])
        down, right = _between_the_pads(rotation * 2 * np.pi / ROTATIONS)
        at = (rows + RIM) * WIDE + cols + RIM
        around = height[at[:, None, None] + (down * WIDE + right)]
        top, floor = height[at], ground[rotation, rows, cols]
        sideways, downwards = _sideways(around, top), _downwards(around, top, floor)
        wedge[rotation, rows, cols] = np.hypot(sideways, downwards)  # small angles, one across
    return wedge


def _between_the_pads(yaw: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rows and columns (6, n), from a grasp's own, of lines along its yaw from pad to pad."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = c * _ALONG - s * _ACROSS[:, None], s * _ALONG + c * _ACROSS[:, None]
    return np.rint(-x / PIXEL).astype(np.intp), np.rint(-y / PIXEL).astype(np.intp)


def _sideways(around: Map, top: Map) -> Array:
    """(k,) radians between the outlines of what stands between the pads, (k, 6, n), at the depth
    that the fingers reach at least."""
    solid = around > np.maximum(top - MIN_GRASP_DEPTH, FLAT)[:, None, None]
    first, met = _first(solid)
    last, _ = _first(solid[:, :, ::-1])
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


def _downwards(around: Map, top: Map, ground: Map) -> Array:
    """(k,) radians between the two faces, as they rise from where the pads reach lowest."""
    low = np.maximum(np.maximum(top - GRASP_DEPTH, ground) + OVER_TIPS, FLAT)
    high = np.clip(top - UNDER_TOP, low + LEAST_RISE, low + UP_TO)
    wedge: Array = np.zeros(len(top))
    for side in (around, around[:, :, ::-1]):
        back = _met(side, high) - _met(side, low) - PIXEL  # what the outlines may err
        wedge += np.arctan2(np.maximum(back, 0), high - low)
    return wedge


def _met(side: Map, level: Map) -> Array:
    """(k,) metres that a pad closes, from its open place, until at this height it meets two of the
    lines (k, 6, n): one alone may be noise."""
    first, met = _first(side > level[:, None, None])
    way = np.where(met, first, side.shape[2])
    second: Array = np.partition(way, 1, axis=1)[:, 1] * PIXEL
    return second


def _first(solid: Mask) -> tuple[npt.NDArray[np.intp], Mask]:
    """(k, 6) where on each line (k, 6, n) something is met first, and whether anything is."""
    first = solid.argmax(axis=2)
    return first, np.take_along_axis(solid, first[:, :, None], axis=2)[:, :, 0]
