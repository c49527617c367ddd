"""Has the tripod moved? Tags on the table, compared in pixels with where they were.

Pixels, not poses: one tag's pose is hundreds of times more uncertain than its corners, and would
raise false alarms long before a real move shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array
from tdpg_deploy.markers import table_tags

LEAST_TAGS = 3
CORNER_NOISE = 0.08  # px: half as much again as a sharp tag shows, for changing light
FALSE_ALARMS = 1e-6  # per frame
LEAST_MOVE = 0.15  # px of common motion; smaller is below 0.2 mm at a metre


@dataclass(frozen=True, kw_only=True, eq=False)
class TagCorners:
    """corners: tag id -> (4, 2) px."""

    corners: dict[int, Array]


@dataclass(frozen=True, kw_only=True)
class Drift:
    """move: px, mean over the tags' corners of the common motion. moved: whether that is real.
    tags: how many were compared."""

    move: float
    moved: bool
    tags: int


def find_tags(picture: npt.NDArray[np.uint8]) -> TagCorners:
    """picture: (H, W) or (H, W, 3). Corners to a fraction of a pixel."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, ids, _ = cv2.aruco.ArucoDetector(table_tags(), parameters).detectMarkers(picture)
    if len(corners) == 0:  # ids is None then
        return TagCorners(corners={})
    found = np.asarray(corners, np.float64).reshape(-1, 4, 2)
    numbers = np.asarray(ids, np.int64).reshape(-1)
    return TagCorners(corners={int(i): c for i, c in zip(numbers, found, strict=True)})


def compare(before: TagCorners, now: TagCorners) -> Drift:
    """Common motion of the tags: shift, turn and zoom. One tag that was pushed is not drift.

    Raises CalibrationError when too few of the tags are seen.
    """
    common = sorted(before.corners.keys() & now.corners.keys())
    if len(common) < LEAST_TAGS:
        raise CalibrationError(
            f"{len(common)} of {len(before.corners)} table tags are seen, {LEAST_TAGS} are needed "
            "to tell whether the camera has moved: uncover them, or calibrate again"
        )
    start = np.stack([before.corners[i] for i in common])
    shift = np.stack([now.corners[i] for i in common]) - start
    centre = start.reshape(-1, 2).mean(axis=0)
    kept = np.ones(len(common), bool)
    motion = _common_motion(start - centre, shift)
    errors = np.linalg.norm(shift - motion, axis=2).mean(axis=1)
    worst = int(errors.argmax())
    if len(common) > LEAST_TAGS and errors[worst] > 6 * CORNER_NOISE:
        kept[worst] = False
        motion = _common_motion((start - centre)[kept], shift[kept])
    size = float(np.sqrt((motion**2).sum(axis=2).mean()))
    # The four numbers of a similarity, each with twice the corner noise of both pictures.
    statistic = float((motion**2).sum() / (2 * CORNER_NOISE**2))
    moved = statistic > chdtri(4, FALSE_ALARMS) and size > LEAST_MOVE
    return Drift(move=size, moved=bool(moved), tags=int(kept.sum()))


def check_still(before: TagCorners, now: TagCorners) -> None:
    """Raises CalibrationError if the camera or the table has moved."""
    drift = compare(before, now)
    if drift.moved:
        raise CalibrationError(
            f"the table tags have moved by {drift.move:.2f} px since the calibration: the camera "
            "or the table was moved; calibrate again"
        )


def _common_motion(start: Array, shift: Array) -> Array:
    """The similarity that explains `shift` (t, 4, 2) best, evaluated at `start` (t, 4, 2)."""
    x, y = start.reshape(-1, 2).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    design = np.concatenate(
        [np.stack([one, zero, x, -y], axis=1), np.stack([zero, one, y, x], axis=1)]
    )
    flat = shift.reshape(-1, 2)
    solution = np.linalg.lstsq(design, np.concatenate([flat[:, 0], flat[:, 1]]), rcond=None)[0]
    fitted = (design @ solution).reshape(2, -1).T
    return np.asarray(fitted.reshape(start.shape), np.float64)
