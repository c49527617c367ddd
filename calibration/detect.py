"""The board in a picture: where its corners are, or what is wrong with the picture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from calibration.pictures import board_in_front, paint_board
from calibration.printing import dictionary
from calibration.target import DEFAULT_TARGET, CharucoTarget
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array
from tdpg_deploy.hal import Intrinsics

LEAST_CORNERS = 8
LEAST_SHARE = 0.3  # of the board's corners
LEAST_MARKER = 14.0  # px; smaller ones are misread
WIDEST_EDGE = 5.0  # px from black to white; a sharp D435 picture has 2 to 3
DARKEST_WHITE, LEAST_CONTRAST = 70, 40  # of 255
FOREIGN = (
    "DICT_4X4_1000",
    "DICT_5X5_1000",
    "DICT_6X6_1000",
    "DICT_7X7_1000",
    "DICT_APRILTAG_36h11",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Detection:
    """ids: (n,) of inner corners. corners: (n, 2) px, pixel centres integer.

    problems: why the picture should not be used, each beginning with blurred, dark, far, partial,
    wrong board or no board; empty when it is good.
    """

    ids: npt.NDArray[np.int64]
    corners: Array
    problems: tuple[str, ...]


def charuco_board(target: CharucoTarget) -> cv2.aruco.CharucoBoard:
    board = cv2.aruco.CharucoBoard(
        (target.columns, target.rows), target.square, target.marker, dictionary(target)
    )
    board.setLegacyPattern(target.legacy)
    return board


def detect(picture: npt.NDArray[np.uint8], target: CharucoTarget) -> Detection:
    """picture: (H, W) grey or (H, W, 3) RGB."""
    grey = picture if picture.ndim == 2 else _grey(picture)
    board = charuco_board(target)
    corners, ids, marker_corners, marker_ids = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    if marker_ids is None or len(marker_ids) == 0:
        return _nothing(_why_nothing(grey, target))
    seen_ids = np.asarray(marker_ids, np.int64).reshape(-1)
    pixels = np.asarray(marker_corners, np.float64).reshape(-1, 4, 2)
    across = float(np.median(np.linalg.norm(np.diff(pixels, axis=1), axis=2)))
    if across < LEAST_MARKER:
        return _nothing(
            f"far: markers are {across:.0f} px across, {LEAST_MARKER:.0f} are needed to read them; "
            "bring the board nearer"
        )
    foreign = seen_ids[seen_ids >= len(target.white_squares())]
    if len(foreign):
        return _nothing(
            f"wrong board: marker {foreign.min()} is not on a board of "
            f"{target.columns} x {target.rows} squares"
        )
    other = charuco_board(replace(target, legacy=not target.legacy))
    if len(seen_ids) > 1 and _misplaced(board, pixels, seen_ids) > 0.05:
        return _nothing(
            "wrong board: its markers are elsewhere than on the one given; check columns, rows, "
            "and the sizes of square and marker"
        )
    if ids is None or len(ids) < 4:
        fitting = cv2.aruco.CharucoDetector(other).detectBoard(grey)[1]
        if fitting is not None and len(fitting) > LEAST_SHARE * len(target.corners()):
            return _nothing(f"wrong board: it fits with legacy = {not target.legacy}")
        return _nothing(f"partial: {len(seen_ids)} markers of the board are seen, no corners")
    found_ids = np.asarray(ids, np.int64).reshape(-1)
    found = np.asarray(corners, np.float64).reshape(-1, 2)
    return Detection(
        ids=found_ids, corners=found, problems=_problems(grey, found, len(target.corners()))
    )


def self_test() -> None:
    """Detect a rendered board. OpenCV 4.13 is half a pixel off; a change like that stops here.

    Raises CalibrationError.
    """
    lens = Intrinsics(width=640, height=480, fx=600.0, fy=600.0, cx=320.0, cy=240.0)
    X_camera_board = board_in_front(DEFAULT_TARGET, 0.5)
    picture = paint_board(
        np.full((480, 640, 3), 128, np.uint8), DEFAULT_TARGET, X_camera_board, lens
    )
    found = detect(picture, DEFAULT_TARGET)
    p_camera = X_camera_board @ DEFAULT_TARGET.corners()[found.ids]
    expected = p_camera[:, :2] / p_camera[:, 2:] * [lens.fx, lens.fy] + [lens.cx, lens.cy]
    bias = (found.corners - expected).mean(axis=0) if len(found.ids) else np.array([np.inf] * 2)
    if not np.abs(bias).max() < 0.1:
        raise CalibrationError(
            f"OpenCV {cv2.__version__} finds the corners of a rendered board "
            f"({bias[0]:.2f}, {bias[1]:.2f}) px off: install opencv-python-headless 4.14"
        )


def _grey(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)


def _nothing(problem: str) -> Detection:
    return Detection(ids=np.zeros(0, np.int64), corners=np.zeros((0, 2)), problems=(problem,))


def _why_nothing(grey: npt.NDArray[np.uint8], target: CharucoTarget) -> str:
    white = float(np.percentile(grey, 99))
    if white < DARKEST_WHITE:
        return f"dark: the brightest parts reach {white:.0f} of 255; add light or exposure"
    for name in FOREIGN:
        if name[:8] == target.dictionary[:8]:
            continue
        other = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        _, ids, _ = cv2.aruco.ArucoDetector(other).detectMarkers(grey)
        if ids is not None and len(ids) >= 4:
            return f"wrong board: it has markers of {name}, not of {target.dictionary}"
    edge = _edge_width(grey, None)
    if white - float(np.percentile(grey, 1)) > LEAST_CONTRAST and edge > WIDEST_EDGE:
        return f"blurred: edges are {edge:.1f} px wide, no marker is readable; hold still, or focus"
    return "no board: no marker is seen"


def _misplaced(
    board: cv2.aruco.CharucoBoard, pixels: Array, marker_ids: npt.NDArray[np.int64]
) -> float:
    """How far a quarter of the markers' corners (m, 4, 2) are from the board's own, in squares."""
    points = np.stack([np.asarray(p) for p in board.getObjPoints()])[marker_ids]
    flat, flat_pixels = points.reshape(-1, 3)[:, :2], pixels.reshape(-1, 2)
    homography, _ = cv2.findHomography(flat_pixels, flat, cv2.RANSAC, 0.1 * board.getSquareLength())
    if np.shape(homography) != (3, 3):
        return 1.0
    moved = cv2.perspectiveTransform(flat_pixels[:, None], homography)[:, 0]
    distances = np.linalg.norm(moved - flat, axis=1)
    return float(np.percentile(distances, 75) / board.getSquareLength())


def _problems(grey: npt.NDArray[np.uint8], corners: Array, all_corners: int) -> tuple[str, ...]:
    problems = []
    needed = max(LEAST_CORNERS, int(LEAST_SHARE * all_corners))
    if len(corners) < needed:
        problems.append(
            f"partial: {len(corners)} of {all_corners} corners are seen, {needed} are needed"
        )
    region = np.zeros(grey.shape, np.uint8)
    cv2.fillConvexPoly(region, cv2.convexHull(np.round(corners).astype(np.int32)), 1)
    inside = region.astype(bool)
    black, white = np.percentile(grey[inside], [5, 95])
    if white < DARKEST_WHITE or white - black < LEAST_CONTRAST:
        problems.append(
            f"dark: white is {white:.0f}, black {black:.0f} of 255; add light or exposure"
        )
    edge = _edge_width(grey, inside)
    if edge > WIDEST_EDGE:
        problems.append(f"blurred: edges are {edge:.1f} px wide; hold still, or focus")
    return tuple(problems)


def _edge_width(grey: npt.NDArray[np.uint8], inside: npt.NDArray[np.bool_] | None) -> float:
    """Pixels from dark to bright at the steepest edges, along the blurrier axis of the picture."""
    picture = grey.astype(np.float32)
    chosen = inside if inside is not None else np.ones(grey.shape, bool)
    tail = 5.0 if inside is not None else 0.5  # per cent; a board is a small part of a picture
    contrast = float(np.subtract(*np.percentile(picture[chosen], [100 - tail, tail])))
    slopes = [cv2.Sobel(picture, cv2.CV_32F, dx, 1 - dx, ksize=3) / 8 for dx in (1, 0)]
    steepest = min(float(np.percentile(np.abs(slope[chosen]), 100 - tail / 5)) for slope in slopes)
    return contrast / max(steepest, 1e-3)
