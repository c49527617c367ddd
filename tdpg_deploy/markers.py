"""ArUco markers as rectangles: for what is printed, and for what lies on a simulated table."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

TABLE_TAGS = "DICT_APRILTAG_36h11"  # the dictionary of the tags on the table
TAG_SIDE = 0.05  # m, black border included
TAG_COUNT = 4


def table_tags() -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, TABLE_TAGS))


def marker_rectangles(
    markers: cv2.aruco.Dictionary, marker_id: int, side: float, corner: npt.ArrayLike
) -> npt.NDArray[np.float64]:
    """(n, 4) x0, y0, x1, y1 of a marker's dark cells, x to the right and y down. side: m, black
    border included; corner: its upper left one (2,), m."""
    across = int(markers.markerSize) + 2
    dark = cv2.aruco.generateImageMarker(markers, marker_id, across, borderBits=1) == 0
    cells = np.array([[x0, row, x1, row + 1] for x0, x1, row in _dark_runs(dark)], np.float64)
    return np.asarray(cells * (side / across) + np.tile(corner, 2), np.float64)


def _dark_runs(cells: npt.NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """Runs (x0, x1, y) of dark cells, so that no hairlines show between them."""
    runs = []
    for y, row in enumerate(cells):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
        runs += [(int(a), int(b), y) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return runs
