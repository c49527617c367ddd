"""Is the calibration this camera's and fresh, and does the camera still stand where it did?"""

from __future__ import annotations

from collections.abc import Iterator

from calibration.drift import TagCorners, compare, find_tags
from tdpg_deploy.calibration_file import Calibration, check_applies
from tdpg_deploy.doctor.finding import Finding, judge
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.hal import RgbdFrame

CAMERA = "camera"


def examine_calibration(calibration: Calibration | None, frame: RgbdFrame) -> Iterator[Finding]:
    """frame: what the camera sees now."""
    if calibration is None:
        yield judge(
            CAMERA,
            "calibration",
            "its pose is typed into the cell file",
            good=False,
            remedy="nobody knows its error: tdpg-calibrate makes a calibration, which "
            "camera.calibration names",
        )
        return
    yield _age(calibration, frame)
    yield _drift(calibration, frame)


def _age(calibration: Calibration, frame: RgbdFrame) -> Finding:
    height, width = frame.color.shape[:2]
    problem = ""
    try:
        check_applies(calibration, serial=frame.serial, width=width, height=height)
    except CalibrationError as error:
        problem = str(error)
    days, within = calibration.age().days, calibration.quality.position_sd
    return judge(
        CAMERA,
        "calibration",
        f"{days} days old, position within {within * 1e3:.2f} mm (one sigma)",
        good=not problem,
        bad=True,
        remedy=problem,
    )


def _drift(calibration: Calibration, frame: RgbdFrame) -> Finding:
    """Whether the table tags are where the calibration saw them."""
    before = TagCorners(corners=calibration.tag_corners())
    try:
        drift = compare(before, find_tags(frame.color))
    except CalibrationError as error:
        remedy = "put the tags of docs/calibration.md on the table before the next calibration"
        return judge(
            CAMERA,
            "still there",
            str(error) if calibration.tags else "the calibration saw no table tags",
            good=False,
            remedy=remedy,
        )
    return judge(
        CAMERA,
        "still there",
        f"{drift.tags} table tags have moved by {drift.move:.2f} pixels",
        good=not drift.moved,
        bad=True,
        remedy="the camera or the table was moved: calibrate again",
    )
