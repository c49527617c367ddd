"""Where a 2F-85 comes down, and what is known of the ground there, for all actions
at once. The plan of the one that is chosen is checked again, exactly, by whoever moves the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F

from policies.gripper import CLOSED_GRIPPER, MAX_UNKNOWN, OPEN_GRIPPER, Part
from policies.heightmap import INSIDE, PIXEL, RIM, SIZE, Heightmap
from policies.policy import HALF_TURN, ROTATIONS

Map = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """Under the gripper at each pixel, for eight rotations: the other half repeats them.

    highest: (8, 224, 224) metres above the table below which the closed finger tips would meet
    something that was seen; 0 where nothing was.
    known: (8, 224, 224) whether enough was seen of the ground under the fingers.
    """

    highest: Map
    known: npt.NDArray[np.bool_]


def under_open_gripper(heightmap: Heightmap) -> Ground:
    """Where a grasp at each pixel comes down."""
    return _under(heightmap, OPEN_GRIPPER)


def under_closed_gripper(heightmap: Heightmap) -> Ground:
    """Where a push at each pixel comes down, its two fingers side by side across the travel."""
    return _under(heightmap, CLOSED_GRIPPER)


def pixels_under(mask: npt.NDArray[np.bool_], part: Part) -> Map:
    """(8, 224, 224) how many of the mask's pixels lie under a part that comes down at each."""
    ones = mask.astype(np.float32)
    counts = np.empty((HALF_TURN, *mask.shape), np.float32)
    for count, footprint, place in zip(counts, *_shape(part), strict=True):
        under_one = cv2.filter2D(ones, -1, footprint, borderType=cv2.BORDER_CONSTANT)
        cv2.filter2D(under_one, -1, place, count, borderType=cv2.BORDER_CONSTANT)
    return counts


def under_any(places: npt.NDArray[np.bool_], part: Part) -> npt.NDArray[np.bool_]:
    """(224, 224) what lies under a part that comes down at any of the places (8, 224, 224)."""
    under = np.zeros(places.shape[1:], np.uint8)
    for at, footprint, place in zip(places, *_shape(part), strict=True):
        if at.any():
            under |= cv2.dilate(cv2.dilate(at.astype(np.uint8), place), footprint)
    return under > 0


def _shape(part: Part) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    return _footprints(part.along, part.across), _places(part.apart)


_THIN = 2 * PIXEL


def _under(heightmap: Heightmap, parts: Sequence[Part]) -> Ground:
    """The ground is known or not under the first of the parts, the one that reaches lowest.
    Beyond the map, what was not seen is table: the cell's owner vouches for it."""
    wide = heightmap.wide
    filled: Map = np.where(np.isfinite(wide), wide, np.float32(0))
    smooth = cv2.medianBlur(filled, 3).astype(np.float32, copy=False)  # no lone specks
    unknown = _unknown(heightmap.valid, parts[0])
    known = np.empty((HALF_TURN, SIZE, SIZE), np.bool_)
    for rotation, place in enumerate(_places(parts[0].apart)):
        known[rotation] = cv2.dilate(unknown[rotation], place)[INSIDE, INSIDE] <= MAX_UNKNOWN
    highest = np.zeros(known.shape, np.float32)
    for part in parts:
        np.maximum(highest, _highest(smooth, part)[:, INSIDE, INSIDE] - part.rise, out=highest)
    return Ground(highest=highest, known=known)


def _highest(height: Map, part: Part) -> Map:
    """(8, n, n) of height (n, n): the maximum under a part at each pixel."""
    # One thin rectangle after the other covers what the whole one does, for a fourth of the work.
    lengthwise = _footprints(part.along - _THIN, _THIN)
    crosswise = _footprints(_THIN, part.across - _THIN)
    highest = np.empty((HALF_TURN, *height.shape), np.float32)
    for rotation, place in enumerate(_places(part.apart)):
        at_each = cv2.dilate(cv2.dilate(height, lengthwise[rotation]), crosswise[rotation])
        cv2.dilate(at_each, place, highest[rotation])
    return highest


def _unknown(seen: npt.NDArray[np.bool_], part: Part) -> Map:
    """(8, n, n) share of a part's rectangle around each pixel, those beyond the map too, that was
    not seen. Counted on pixels of twice the size: a sixteenth of the work, and near enough."""
    unseen = torch.from_numpy(np.pad((~seen).astype(np.float32), RIM))
    footprints = _footprints(part.along, part.across, pixel=2 * PIXEL)
    weights = torch.from_numpy(footprints[:, None].astype(np.float32))
    weights /= weights.sum((2, 3), keepdim=True)
    share = F.conv2d(F.avg_pool2d(unseen[None, None], 2), weights, padding="same")
    unknown: Map = F.interpolate(share, scale_factor=2.0)[0].numpy()
    return unknown


@cache
def _footprints(along: float, across: float, pixel: float = PIXEL) -> npt.NDArray[np.uint8]:
    """(8, n, n) the pixels of a rectangle with these sides along and across each yaw."""
    x, y, c, s = _around(int(np.hypot(along, across) / 2 / pixel), pixel)
    u, v = c * x + s * y, c * y - s * x
    inside: npt.NDArray[np.bool_] = np.maximum(abs(u) - along / 2, abs(v) - across / 2) <= 1e-9
    return inside.astype(np.uint8)


@cache
def _places(apart: float) -> npt.NDArray[np.uint8]:
    """(8, n, n) the two pixels that lie `apart` metres from each other, along each yaw."""
    x, y, c, s = _around(int(apart / 2 / PIXEL) + 1, PIXEL)
    squared = (abs(c * x + s * y) - apart / 2) ** 2 + (c * y - s * x) ** 2
    # The two are as near as each other, or one and the same: rounding must not tell them apart.
    nearest: npt.NDArray[np.bool_] = squared <= squared.min(axis=(1, 2), keepdims=True) + 1e-12
    return nearest.astype(np.uint8)


def _around(reach: int, pixel: float) -> tuple[Array, Array, Array, Array]:
    """x, y of pixels (n, n) around one, in base (m); cosine and sine of each yaw (8, 1, 1)."""
    pixels = np.arange(-reach, reach + 1) * pixel
    x, y = np.meshgrid(-pixels, -pixels, indexing="ij")
    yaw = np.arange(HALF_TURN)[:, None, None] * 2 * np.pi / ROTATIONS
    return x, y, np.cos(yaw), np.sin(yaw)
