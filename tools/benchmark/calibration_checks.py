"""What guards a calibration in use, on truth: depth after its correction, and the drift check."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from calibration.depth import DepthSamples, fit_depth
from calibration.drift import compare, find_tags
from calibration.synthetic import D435_720P
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.markers import TAG_SIDE, table_tags
from tools.benchmark.measure import Measurement

# A D435 off by 1 % in scale and 0.1 px of disparity, between these distances.
NEAR, FAR = 0.5, 1.1  # m
SCALE_ERROR, DISPARITY_ERROR = 0.01, 0.1  # px
DEPTH_FOCAL, BASELINE, SUBPIXEL = 650.0, 0.05, 0.08  # px at 1280 x 720, m, px
DEPTH_TRIALS, DEPTH_VIEWS, SQUARES, PIXELS_A_SQUARE = 200, 15, 27, 80

STILL_FRAMES, MOVES_EACH = 1000, 10
TAG = 300  # px of the drawing
PLACES = ((-0.27, -0.17), (0.27, -0.17), (-0.27, 0.17), (0.27, 0.17))  # m from the middle
X_CAMERA_TABLE = Transform(Rotation.from_euler("x", 20, degrees=True), np.array([0, 0, 0.76]))
GREY_NOISE = 3.0  # grey levels
OVERSAMPLED = 3


def measure_depth() -> Measurement:
    """Mean of what the correction leaves over the range of distances, on truth, mm."""
    rng = np.random.default_rng(0)
    left = []
    z = np.linspace(NEAR, FAR, 200, dtype=np.float64)
    for _ in range(DEPTH_TRIALS):
        samples = []
        for distance in rng.uniform(NEAR, FAR, DEPTH_VIEWS):
            true: Array = distance + rng.uniform(-0.05, 0.05, SQUARES)
            sigma = true**2 * SUBPIXEL / (DEPTH_FOCAL * BASELINE) / np.sqrt(PIXELS_A_SQUARE)
            seen = measured_depth(true) + rng.normal(0, sigma)
            samples.append(DepthSamples(expected=true, measured=seen))
        model, _ = fit_depth(samples)
        corrected = model.correct(measured_depth(z).astype(np.float32))
        left.append(1e3 * float(np.abs(corrected - z).mean()))
    low, median, high = np.percentile(left, [5, 50, 95])
    return Measurement(
        name="depth left after correction, 0.5 to 1.1 m",
        unit="mm",
        median=float(median),
        low=float(low),
        high=float(high),
        reference=1e3 * float(np.abs(measured_depth(z) - z).mean()),
        repeats=DEPTH_TRIALS,
    )


def measured_depth(z: Array) -> Array:
    """What the camera that is off says for z (m)."""
    disparity = DEPTH_FOCAL * BASELINE / z
    return (1 + SCALE_ERROR) * DEPTH_FOCAL * BASELINE / (disparity - DISPARITY_ERROR)


def measure_drift() -> list[Measurement]:
    """Alarms in pictures of four tags, the camera standing still, and moved by 1 mm or 0.05
    degrees along or about each of its axes."""
    rng = np.random.default_rng(1)
    still = draw(X_CAMERA_TABLE)
    before = find_tags(noisy(still, rng))
    false = [compare(before, find_tags(noisy(still, rng))).moved for _ in range(STILL_FRAMES)]
    seen = []
    for X_camera_table in small_moves():
        moved = draw(X_camera_table)
        seen += [compare(before, find_tags(noisy(moved, rng))).moved for _ in range(MOVES_EACH)]
    return [
        _share("drift check: false alarms", false),
        _share("drift check: moves of 1 mm or 0.05 degrees seen in one frame", seen),
    ]


def small_moves() -> Iterator[Transform]:
    for axis in np.eye(3):
        for sign in (-1, 1):
            yield Transform(Rotation.identity(), sign * 1e-3 * axis) @ X_CAMERA_TABLE
            turn = Rotation.from_rotvec(sign * np.deg2rad(0.05) * axis)
            yield Transform(turn, np.zeros(3)) @ X_CAMERA_TABLE


def draw(X_camera_table: Transform) -> npt.NDArray[np.float64]:
    """(720, 1280) grey: four tags on a table, each pixel the mean of 9 rays."""
    lens = D435_720P
    fine = replace(
        lens,
        width=lens.width * OVERSAMPLED,
        height=lens.height * OVERSAMPLED,
        fx=lens.fx * OVERSAMPLED,
        fy=lens.fy * OVERSAMPLED,
        cx=(lens.cx + 0.5) * OVERSAMPLED - 0.5,
        cy=(lens.cy + 0.5) * OVERSAMPLED - 0.5,
    )
    picture = np.full((fine.height, fine.width), 150, np.uint8)
    border = TAG // 8
    for number, (x, y) in enumerate(PLACES):
        tag = cv2.aruco.generateImageMarker(table_tags(), number, TAG)
        sheet = np.pad(np.where(tag > 0, 230, 25).astype(np.uint8), border, constant_values=230)
        to_metres = np.array(
            [
                [TAG_SIDE / TAG, 0, x - TAG_SIDE / 2 - (border - 0.5) * TAG_SIDE / TAG],
                [0, TAG_SIDE / TAG, y - TAG_SIDE / 2 - (border - 0.5) * TAG_SIDE / TAG],
                [0, 0, 1],
            ]
        )
        R, t = X_camera_table.rotation.as_matrix(), X_camera_table.translation
        to_pixels = fine.as_matrix() @ np.column_stack([R[:, :2], t]) @ to_metres
        cv2.warpPerspective(
            sheet, to_pixels, picture.shape[::-1], picture, borderMode=cv2.BORDER_TRANSPARENT
        )
    small = cv2.resize(picture, (lens.width, lens.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float64)


def noisy(picture: npt.NDArray[np.float64], rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    return (picture + rng.normal(0, GREY_NOISE, picture.shape)).clip(0, 255).astype(np.uint8)


def _share(name: str, told: list[bool]) -> Measurement:
    share = 100 * float(np.mean(told))
    return Measurement(name=name, unit="%", median=share, low=share, high=share, repeats=len(told))
