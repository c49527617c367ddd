"""The rectangle that some pixels show, by least squares: between pixels, though each is noisy."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.optimize import least_squares

from policies.standing import Mask
from tdpg_deploy.geometry import Array

MISFIT = 0.12  # of a rectangle's area at most, that differs from it: noise rounds off corners
AROUND = 3  # pixels around it that are to be outside


def rectangle(shown: Mask) -> Array | None:
    """(4, 2) column and row of its corners, in pixels, whose centres are whole; None where the
    pixels (h, w) look like something else."""
    rows, cols = np.nonzero(shown)
    middle, sides, turn = cv2.minAreaRect(np.column_stack([cols, rows]).astype(np.float32))
    corner = np.array([cols.min(), rows.min()]) - AROUND
    x = np.arange(corner[0], cols.max() + AROUND + 1)[:, None]
    y = np.arange(corner[1], rows.max() + AROUND + 1)
    inside = np.zeros((x.size, y.size))
    inside[cols - corner[0], rows - corner[1]] = 1.0

    def misses(at: Array) -> Array:
        missed: Array = (_covered(at, x, y) - inside).ravel()
        return missed

    start = [*middle, sides[0] + 1, sides[1] + 1, np.radians(turn)]
    found = least_squares(misses, start, x_scale=[1, 1, 1, 1, 0.05], diff_step=[0.01] * 5)
    if np.abs(misses(found.x)).sum() > MISFIT * len(rows):
        return None
    col, row, a, b, turned = found.x
    corners = cv2.boxPoints(((col, row), (abs(a), abs(b)), float(np.degrees(turned))))
    return corners.astype(np.float64)


def _covered(at: Array, x: Array, y: Array) -> Array:
    """(w, h) how much of each pixel a rectangle covers, nearly: its middle's column and row, its
    sides, and its turn, rad."""
    col, row, a, b, turned = at
    cos, sin = np.cos(turned), np.sin(turned)
    u = np.abs((x - col) * cos + (y - row) * sin)
    v = np.abs((y - row) * cos - (x - col) * sin)
    covered: Array = np.clip(a / 2 - u + 0.5, 0, 1) * np.clip(b / 2 - v + 0.5, 0, 1)
    return covered
