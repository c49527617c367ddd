"""What tdpg-doctor says of a calibration: its age, whose it is, and whether the camera moved."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from calibration.drift import find_tags
from tdpg_deploy.calibration_file import (
    BoardSection,
    Calibration,
    CameraSection,
    PoseSection,
    QualitySection,
)
from tdpg_deploy.doctor.calibration import examine_calibration
from tdpg_deploy.doctor.finding import Finding, Verdict
from tdpg_deploy.hal import Intrinsics, RgbdFrame
from tdpg_deploy.markers import table_tags

GOOD, DOUBT, BAD = Verdict.GOOD, Verdict.DOUBT, Verdict.BAD
SERIAL = "837212070000"
WIDTH, HEIGHT = 640, 480


def picture(shift: int = 0) -> npt.NDArray[np.uint8]:
    """Four table tags, `shift` pixels to the right of where they were."""
    seen = np.full((HEIGHT, WIDTH), 255, np.uint8)
    for number, (row, col) in enumerate([(60, 80), (60, 480), (330, 80), (330, 480)]):
        tag = cv2.aruco.generateImageMarker(table_tags(), number, 80)
        seen[row : row + 80, col + shift : col + shift + 80] = tag
    return np.repeat(seen[..., None], 3, axis=2)


def frame(color: npt.NDArray[np.uint8], *, serial: str = SERIAL) -> RgbdFrame:
    return RgbdFrame(
        color=color,
        depth=np.ones((HEIGHT, WIDTH), np.float32),
        intrinsics=Intrinsics(width=WIDTH, height=HEIGHT, fx=600, fy=600, cx=319.5, cy=239.5),
        captured_at=0.0,
        sequence=1,
        serial=serial,
    )


def made(days: int, *, tags: bool = True) -> Calibration:
    corners = find_tags(picture()).corners if tags else {}
    pose = PoseSection(position=(0.5, 0.0, 0.8), quaternion=(1.0, 0.0, 0.0, 0.0))
    return Calibration(
        mounting="eye-to-hand",
        parent="base",
        date=datetime.now(timezone.utc) - timedelta(days=days, hours=1),
        camera=CameraSection(
            serial=SERIAL, width=WIDTH, height=HEIGHT, fx=600, fy=600, cx=319.5, cy=239.5,
            distortion=(0, 0, 0, 0, 0), refined=False,
        ),
        pose=pose,
        covariance=tuple(map(tuple, (1e-8 * np.eye(6)).tolist())),
        board=BoardSection(
            columns=7, rows=5, square=0.03, marker=0.022, dictionary="DICT_4X4_50", legacy=False,
            scale=1.0, pose=pose,
        ),
        quality=QualitySection(
            position_sd=0.00042, rotation_sd=1e-3, views_used=20, views_taken=20, rms_px=0.2,
            pixel_noise_px=0.2, arm_noise_position=1e-4, arm_noise_rotation=1e-4,
        ),
        tags={number: tuple(map(tuple, four.tolist())) for number, four in corners.items()},
    )  # fmt: skip


def examined(calibration: Calibration | None, seen: RgbdFrame) -> dict[str, Finding]:
    return {finding.check: finding for finding in examine_calibration(calibration, seen)}


def test_a_fresh_one_of_a_camera_that_stands_still() -> None:
    found = examined(made(3), frame(picture()))
    assert [finding.verdict for finding in found.values()] == [GOOD, GOOD]
    assert found["calibration"].measured == "3 days old, position within 0.42 mm (one sigma)"
    assert found["still there"].measured == "4 table tags have moved by 0.00 pixels"


@pytest.mark.parametrize(
    ("days", "serial", "remedy"),
    [(91, SERIAL, "91 days ago; more than 90"), (1, "1234", "but 1234 is connected")],
)
def test_an_old_one_and_another_cameras(days: int, serial: str, remedy: str) -> None:
    finding = examined(made(days), frame(picture(), serial=serial))["calibration"]
    assert finding.verdict is BAD
    assert remedy in finding.remedy


def test_a_camera_that_was_moved() -> None:
    finding = examined(made(3), frame(picture(shift=4)))["still there"]
    assert finding.verdict is BAD
    assert float(finding.measured.split()[-2]) == pytest.approx(4.0, abs=0.1)


def test_tags_that_are_not_seen() -> None:
    blank = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    assert examined(made(3), frame(blank))["still there"].verdict is DOUBT
    without = examined(made(3, tags=False), frame(picture()))["still there"]
    assert (without.verdict, without.measured) == (DOUBT, "the calibration saw no table tags")


def test_a_pose_that_was_typed_in() -> None:
    (finding,) = examine_calibration(None, frame(picture()))
    assert finding.verdict is DOUBT
    assert "tdpg-calibrate" in finding.remedy
