"""What stands on the table, and what is near it: masks over the heightmap's pixels."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from policies.heightmap import PIXEL, SIZE, Heightmap

RISE = 0.010  # m; what stands higher above the table is an object: four sigma of a D435 at 0.8 m

Mask = npt.NDArray[np.bool_]
Map = npt.NDArray[np.float32]


def rising(heightmap: Heightmap) -> Mask:
    """(224, 224): pixels that were seen to stand above the table, lone specks left out.

    A pixel counts when five of the nine around it (itself one of them) rise by RISE.
    """
    with np.errstate(invalid="ignore"):
        high = heightmap.height > RISE
    padded = np.pad(high.astype(np.uint8), 1)
    votes = sum(padded[i : i + SIZE, j : j + SIZE] for i in range(3) for j in range(3))
    return high & (votes >= 5)


def within(distance: float, mask: Mask) -> Mask:
    """What lies within a square of twice the distance (m) around any of the mask's pixels."""
    return widest(mask.astype(np.float32), round(distance / PIXEL)) > 0


def widest(height: Map, half_width: int) -> Map:
    """Maximum over squares of 2 * half_width + 1 pixels."""
    side = 2 * half_width + 1
    return cv2.dilate(height, np.ones((side, side), np.uint8)).astype(np.float32, copy=False)
