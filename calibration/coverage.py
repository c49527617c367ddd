"""How much of what a camera can see the views have shown, in the terms of ROS's camera_calibration.

Its four parameters of a view (calibrator.py, get_parameters), each from 0 to 1: where the board's
middle is across and down the picture, how large the board is, how skewed its corner looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.views import View
from tdpg_deploy.geometry import Array
from tdpg_deploy.hal import Intrinsics

NAMES = ("across", "down", "size", "skew")
ENOUGH = np.array([0.7, 0.7, 0.4, 0.5])  # ranges that camera_calibration asks for


@dataclass(frozen=True, kw_only=True, eq=False)
class Coverage:
    """low, high: (4,) of NAMES over all views; nan without views."""

    low: Array
    high: Array

    @property
    def share(self) -> Array:
        """(4,) of the range that is asked for, 0 to 1."""
        return np.asarray(np.nan_to_num(np.minimum((self.high - self.low) / ENOUGH, 1.0)))


def coverage(views: Sequence[View], board_corners: Array, lens: Intrinsics) -> Coverage:
    """board_corners: (n, 3) metres by id."""
    if not views:
        return Coverage(low=np.full(4, np.nan), high=np.full(4, np.nan))
    parameters = np.stack([view_parameters(view, board_corners, lens) for view in views])
    return Coverage(low=parameters.min(axis=0), high=parameters.max(axis=0))


def view_parameters(view: View, board_corners: Array, lens: Intrinsics) -> Array:
    """(4,) of NAMES. Corners that are not seen are where a homography puts them."""
    seen = board_corners[view.ids, :2]
    homography, _ = cv2.findHomography(seen, view.corners)
    x0, y0 = board_corners[:, :2].min(axis=0)
    x1, y1 = board_corners[:, :2].max(axis=0)
    outline = np.array([[[x0, y0], [x1, y0], [x1, y1], [x0, y1]]])
    upper_left, upper_right, lower_right, lower_left = cv2.perspectiveTransform(
        outline, homography
    )[0]
    first, second = lower_right - upper_left, lower_left - upper_right
    area = abs(first[0] * second[1] - first[1] * second[0]) / 2
    border = np.sqrt(area)
    size = np.array([lens.width, lens.height])
    middle = view.corners.mean(axis=0)
    place = np.clip((middle - border / 2) / np.maximum(size - border, 1.0), 0.0, 1.0)
    one, two = upper_left - upper_right, lower_right - upper_right
    cosine = float(one @ two / (np.linalg.norm(one) * np.linalg.norm(two)))
    skew = min(1.0, 2 * abs(np.pi / 2 - float(np.arccos(np.clip(cosine, -1, 1)))))
    return np.array([place[0], place[1], np.sqrt(area / size.prod()), skew])
