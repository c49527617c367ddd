"""The second witness of an action: how the heightmap changed. Pure.

Only pixels known both before and after are compared; where too few are, the verdict is unknown.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from policies.heightmap import PIXEL, SIZE, Heightmap
from policies.primitives import Primitive, Push
from tdpg_deploy.geometry import Array
from tdpg_deploy.outcome import Verdict

# A pixel changed by 0.01 m < |dz| < 0.3 m; an action changed at least 300 of them (VPG, main.py).
MIN_CHANGE, MAX_CHANGE = 0.01, 0.3  # m
MIN_PIXELS = 300
# VPG's smallest block is 50 x 50 x 25 mm, 62 ml: half of it gone is a block gone. What only moves
# rises elsewhere by as much as it fell, but for a fifth that the pixels' size leaves open.
GONE_VOLUME = 31e-6  # m^3
GONE_SHARE, MOVED_SHARE = 0.5, 0.2  # of the volume that fell
REACH = 0.12  # m around an action's path: what it pushes or topples stays within
MIN_KNOWN = 0.6  # share of the pixels within reach that have to be known for a NO


def changed(before: Heightmap, after: Heightmap, primitive: Primitive) -> Verdict:
    """Whether anything moved around the path of a push or a grasp."""
    difference, near = _difference(before, after), _reached(before, primitive)
    if int((np.abs(difference[near]) > 0).sum()) >= MIN_PIXELS:
        return Verdict.YES
    return Verdict.NO if _is_known(difference, near) else Verdict.UNKNOWN


def gone(before: Heightmap, after: Heightmap, primitive: Primitive) -> Verdict:
    """Whether volume left the surroundings of a grasp: what only fell over is still there."""
    difference, near = _difference(before, after), _reached(before, primitive)
    fell = -float(np.nansum(np.minimum(difference[near], 0.0))) * PIXEL**2
    lost = -float(np.nansum(difference[near])) * PIXEL**2
    if lost >= GONE_VOLUME and lost >= GONE_SHARE * fell:
        return Verdict.YES
    if lost <= max(GONE_VOLUME / 2, MOVED_SHARE * fell) and _is_known(difference, near):
        return Verdict.NO
    return Verdict.UNKNOWN


def _difference(before: Heightmap, after: Heightmap) -> Array:
    """(224, 224) m: after - before where that is a change, 0 where not, nan where unknown."""
    difference = after.height.astype(np.float64) - before.height
    size = np.abs(difference)
    difference[(size <= MIN_CHANGE) | (size >= MAX_CHANGE)] = 0.0
    return difference


def _reached(heightmap: Heightmap, primitive: Primitive) -> npt.NDArray[np.bool_]:
    """(224, 224): pixels within REACH of the way of the tool over the table."""
    x, y = heightmap.workspace.to_base(*np.indices((SIZE, SIZE)))
    along = np.array([np.cos(primitive.yaw), np.sin(primitive.yaw)])
    length = primitive.length if isinstance(primitive, Push) else 0.0
    u = (x - primitive.x) * along[0] + (y - primitive.y) * along[1]
    v = (y - primitive.y) * along[0] - (x - primitive.x) * along[1]
    reached: npt.NDArray[np.bool_] = np.hypot(u - np.clip(u, 0.0, length), v) <= REACH
    return reached


def _is_known(difference: Array, near: npt.NDArray[np.bool_]) -> bool:
    return bool(np.isfinite(difference[near]).mean() >= MIN_KNOWN) if near.any() else False
