"""Where the fingers of a 2F-85 come down, and what is known of the ground there, for all actions
at once. The plan of the one that is chosen is checked again, exactly, by whoever moves the arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F

from policies.heightmap import PIXEL, SIZE, Heightmap
from policies.policy import ROTATIONS

OPEN_WIDTH = 0.085  # m between the pads, 2F-85 manual, section 6.1
PAD_WIDTH = 0.022  # m, 2F-85 manual, section 6.1
FINGER_DEPTH = 0.018  # m from a pad's face to the finger's back
MAX_UNKNOWN = 0.2  # share of a footprint: lost pixels and the rim of a shadow, no more
MIN_GRASP_DEPTH = 0.02  # m that the fingers reach below a surface, about half of their pads ...
FLAT = 0.01  # m ... or less, where they come down no higher than this above the table

HALF_TURN = ROTATIONS // 2
Map = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """Under a footprint at each pixel, for eight rotations: the other half repeats them.

    highest: (8, 224, 224) metres above the table of what was seen; 0 where nothing was.
    known: (8, 224, 224) whether enough of it was seen.
    """

    highest: Map
    known: npt.NDArray[np.bool_]


def under_open_fingers(heightmap: Heightmap) -> Ground:
    """Where both fingers of a grasp at each pixel come down: the higher of both places."""
    ground = _under(heightmap, along=FINGER_DEPTH, across=PAD_WIDTH)
    offset = (OPEN_WIDTH + FINGER_DEPTH) / 2 / PIXEL
    highest, known = np.zeros_like(ground.highest), np.ones_like(ground.known)
    for rotation in range(HALF_TURN):
        yaw = rotation * 2 * np.pi / ROTATIONS
        down, right = round(-offset * np.cos(yaw)), round(-offset * np.sin(yaw))
        for to, at in (shifted(down, right), shifted(-down, -right)):
            np.maximum(highest[rotation][to], ground.highest[rotation][at], highest[rotation][to])
            known[rotation][to] &= ground.known[rotation][at]
    return Ground(highest=highest, known=known)


def have_room(surface: npt.ArrayLike, ground: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Whether fingers reach deep enough below a surface that they are to grasp before they come
    down on the ground beside it. Metres above the table; broadcast."""
    deep_enough = np.asarray(surface) - np.float32(MIN_GRASP_DEPTH)
    return np.asarray(ground) <= np.maximum(deep_enough, np.float32(FLAT))


def under_closed_fingers(heightmap: Heightmap) -> Ground:
    """Where a push at each pixel comes down, its two fingers side by side across the travel."""
    return _under(heightmap, along=PAD_WIDTH, across=2 * FINGER_DEPTH)


def shifted(down: int, right: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Where pixels have a neighbour so far down and right, and where those neighbours are."""
    (to_rows, at_rows), (to_cols, at_cols) = _overlap(down), _overlap(right)
    return (to_rows, to_cols), (at_rows, at_cols)


def _overlap(shift: int) -> tuple[slice, slice]:
    return slice(max(0, -shift), SIZE - max(0, shift)), slice(max(0, shift), SIZE + min(0, shift))


def _under(heightmap: Heightmap, *, along: float, across: float) -> Ground:
    """Beyond the map lies the table, as the cell's owner vouches."""
    seen = heightmap.valid
    smooth = cv2.medianBlur(np.where(seen, heightmap.height, np.float32(0)), 3)  # no lone specks
    kernels = _footprints(along, across)
    highest = np.empty((HALF_TURN, SIZE, SIZE), np.float32)
    for kernel, above in zip(kernels, highest, strict=True):
        cv2.dilate(smooth, kernel, above, borderType=cv2.BORDER_CONSTANT, borderValue=0.0)
    weights = torch.from_numpy(kernels[:, None].astype(np.float32))
    weights /= weights.sum((2, 3), keepdim=True)
    unseen = torch.from_numpy((~seen).astype(np.float32))[None, None]
    unknown = F.conv2d(unseen, weights, padding="same")[0].numpy()
    return Ground(highest=highest, known=unknown <= MAX_UNKNOWN)


@cache
def _footprints(along: float, across: float) -> npt.NDArray[np.uint8]:
    """(8, n, n) the pixels of a rectangle with these sides along and across each yaw."""
    reach = int(np.hypot(along, across) / 2 / PIXEL)
    pixels = np.arange(-reach, reach + 1) * PIXEL
    x, y = np.meshgrid(-pixels, -pixels, indexing="ij")
    yaw = np.arange(HALF_TURN)[:, None, None] * 2 * np.pi / ROTATIONS
    u, v = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    inside: npt.NDArray[np.bool_] = (np.abs(u) <= along / 2 + 1e-9) & (
        np.abs(v) <= across / 2 + 1e-9
    )
    return inside.astype(np.uint8)
