"""Which pixels of a heightmap show one thing: by the edges of colour and of height between them."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from policies.heightmap import PIXEL, Heightmap
from policies.standing import Map, Mask, rising

Things = npt.NDArray[np.int32]  # (224, 224): which thing each pixel shows; 0 where none

COLOR_EDGE = 20.0  # of CIELAB's 8-bit scale, within three pixels ...
LIGHTNESS = 0.6  # ... where lightness counts less: a thing's sides lie in the shade
HEIGHT_EDGE = 0.010  # m, within three pixels
SMALLEST = 25  # pixels of a thing's middle: a square of 10 mm
GROWTH = 0.010  # m from its middle to its border, at most
_AROUND = np.ones((3, 3), np.uint8)


def things(heightmap: Heightmap) -> Things:
    """What stands on the table, thing by thing. With a goal, no thing lies on both sides of its
    border. Things of like colour and height that touch are one; a thing of two colours is two."""
    objects = rising(heightmap)
    even = objects & ~_edges(heightmap)
    found = np.zeros(objects.shape, np.int32)
    goal = np.zeros_like(objects) if heightmap.goal is None else heightmap.goal
    for part in (objects & goal, objects & ~goal):
        _, labels, stats, _ = cv2.connectedComponentsWithStats(
            (even & part).astype(np.uint8), connectivity=4
        )
        large = stats[:, cv2.CC_STAT_AREA] >= SMALLEST
        large[0] = False  # what is between them
        grown = _grown(np.where(large[labels], labels + found.max(), 0))
        found[part] = grown[part]
    return found


def _edges(heightmap: Heightmap) -> Mask:
    """(224, 224): colour or height change right there."""
    lab = cv2.cvtColor(cv2.medianBlur(heightmap.color, 3), cv2.COLOR_RGB2LAB).astype(np.float32)
    lab[..., 0] *= LIGHTNESS
    height = cv2.medianBlur(np.nan_to_num(heightmap.height), 3).astype(np.float32, copy=False)
    edges: Mask = np.linalg.norm(_spread(lab), axis=2) > COLOR_EDGE
    return edges | (_spread(height) > HEIGHT_EDGE)


def _spread(values: Map) -> Map:
    """The highest less the lowest of the nine around each pixel, channel by channel."""
    spread: Map = cv2.morphologyEx(values, cv2.MORPH_GRADIENT, _AROUND).astype(
        np.float32, copy=False
    )
    return spread


def _grown(middles: Things) -> Things:
    """Each pixel within GROWTH of a middle is of the nearest one."""
    if not middles.any():
        return middles
    distance, (rows, cols) = distance_transform_edt(middles == 0, return_indices=True)
    grown: Things = np.where(distance * PIXEL <= GROWTH, middles[rows, cols], 0)
    return grown
