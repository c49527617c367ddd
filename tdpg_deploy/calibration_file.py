"""The calibration file: one versioned YAML, read strictly.

Lengths in metres, angles in radians, quaternions scalar last; docs/calibration.md lists every
field. A file that is missing, too old, from a newer version, or made for another camera is
refused with what to do.
"""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tdpg_deploy.depth_model import DepthModel
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

VERSION = 1
MAX_AGE = timedelta(days=90)
Finite = Annotated[float, Field(allow_inf_nan=False)]
Corner = tuple[Finite, Finite]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class PoseSection(_Section):
    """position: metres. quaternion: x, y, z, w."""

    position: tuple[Finite, Finite, Finite]
    quaternion: tuple[Finite, Finite, Finite, Finite]

    @model_validator(mode="after")
    def _unit(self) -> PoseSection:
        norm = float(np.linalg.norm(self.quaternion))
        if abs(norm - 1) > 1e-3:
            raise ValueError(f"the quaternion has norm {norm:.4f}, not 1")
        return self

    @classmethod
    def of(cls, X: Transform) -> PoseSection:
        x, y, z = (float(value) for value in X.translation)
        qx, qy, qz, qw = (float(value) for value in X.as_quaternion())
        return cls(position=(x, y, z), quaternion=(qx, qy, qz, qw))

    def transform(self) -> Transform:
        return Transform.from_quaternion(self.position, self.quaternion)


class CameraSection(_Section):
    """The colour stream that was calibrated."""

    serial: str
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    fx: Positive
    fy: Positive
    cx: Finite
    cy: Finite
    distortion: tuple[Finite, Finite, Finite, Finite, Finite]
    refined: bool

    def intrinsics(self) -> Intrinsics:
        return Intrinsics(**self.model_dump(exclude={"serial", "refined"}))


class BoardSection(_Section):
    """The board, and where it was. scale: printed over nominal size."""

    columns: int
    rows: int
    square: Positive
    marker: Positive
    dictionary: str
    legacy: bool
    scale: Positive
    pose: PoseSection


class QualitySection(_Section):
    """Standard deviations of the result, and how well the views agree."""

    position_sd: Positive
    rotation_sd: Positive
    views_used: int
    views_taken: int
    rms_px: Positive
    pixel_noise_px: Positive
    arm_noise_position: Positive
    arm_noise_rotation: Positive


class DepthSection(_Section):
    """1/z = a / z_measured + b, and what it leaves."""

    a: Positive
    b: Finite
    offset: Finite
    rms: Finite
    fill: Finite
    left: Finite

    def model(self) -> DepthModel:
        return DepthModel(a=self.a, b=self.b)


class TableSection(_Section):
    """height: of the table in base at the workspace's middle. tilt: from horizontal. rms: m."""

    height: Finite
    tilt: Finite
    rms: Finite


class Calibration(_Section):
    """A whole calibration file.

    pose: X_base_camera when eye-to-hand, X_tool_camera when eye-in-hand.
    covariance: of pose, 6 x 6: x, y, z, then rotation vector, along the axes of `parent`.
    record_sha256: of the record that it can be solved from again.
    tags: corners (px) of the tags on the table, by id, as the camera saw them then.
    """

    format: Literal["tdpg-calibration"] = "tdpg-calibration"
    version: int = VERSION
    mounting: Literal["eye-to-hand", "eye-in-hand"]
    parent: Literal["base", "tool"]
    units: Literal["m, rad, px"] = "m, rad, px"
    date: datetime
    arm_serial: str | None = None
    camera: CameraSection
    pose: PoseSection
    covariance: tuple[tuple[Finite, ...], ...]
    board: BoardSection
    quality: QualitySection
    depth: DepthSection | None = None
    table: TableSection | None = None
    record_sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None
    tags: dict[int, tuple[Corner, Corner, Corner, Corner]] = {}

    @model_validator(mode="after")
    def _consistent(self) -> Calibration:
        parent = "base" if self.mounting == "eye-to-hand" else "tool"
        if self.parent != parent:
            raise ValueError(f"parent = {self.parent}: {self.mounting} means {parent}")
        if self.date.tzinfo is None:
            raise ValueError("date needs a time zone, such as 2026-05-04T12:00:00Z")
        covariance = self.covariance_matrix()
        if covariance.shape != (6, 6) or np.linalg.eigvalsh(covariance).min() < 0:
            raise ValueError("covariance must be 6 x 6 and positive")
        return self

    def covariance_matrix(self) -> Array:
        if len({len(row) for row in self.covariance}) > 1:
            return np.zeros((0, 0))
        return np.array(self.covariance, np.float64)

    def age(self, now: datetime | None = None) -> timedelta:
        """Since it was made; now: with a time zone, this moment by default."""
        return (now or datetime.now(timezone.utc)) - self.date

    def tag_corners(self) -> dict[int, Array]:
        """Tag id -> (4, 2) px; empty where no table tags were seen."""
        return {number: np.array(corners, np.float64) for number, corners in self.tags.items()}


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Written whole or not at all. Raises CalibrationError."""
    data = calibration.model_dump(mode="json")
    text = "# Hand-eye calibration; docs/calibration.md explains every field.\n"
    text += yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written ({error.strerror})") from error


def load_calibration(path: Path) -> Calibration:
    """Raises CalibrationError that names what is wrong."""
    data = read_yaml(path)
    if data.get("format") != "tdpg-calibration":
        raise CalibrationError(
            f"{path}: not a calibration of this project; "
            "`tdpg-calibrate import` reads those of easy_handeye and VPG"
        )
    version = data.get("version")
    if version != VERSION:
        raise CalibrationError(
            f"{path}: format version {version!r}; this program reads {VERSION}: "
            "update it, or calibrate again"
        )
    try:
        return Calibration.model_validate(data)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(str(part) for part in problem['loc']) or 'file'}: {problem['msg']}"
            for problem in error.errors()
        )
        raise CalibrationError(f"{path}: {problems}") from error


def read_yaml(path: Path) -> dict[str, Any]:
    """A mapping. Raises CalibrationError."""
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationError(
            f"{path}: cannot be read ({error.strerror}); run `tdpg-calibrate` to make one"
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: not YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(data, dict):
        raise CalibrationError(f"{path}: holds no mapping of names to values")
    return data


def check_applies(
    calibration: Calibration,
    *,
    serial: str,
    width: int,
    height: int,
    now: datetime | None = None,
    max_age: timedelta = MAX_AGE,
) -> None:
    """That it is this camera's, at this resolution, and not stale. Raises CalibrationError."""
    if calibration.camera.serial != serial:
        raise CalibrationError(
            f"calibrated for camera {calibration.camera.serial}, but {serial} is connected: "
            "connect that one, or calibrate this one"
        )
    calibrated = (calibration.camera.width, calibration.camera.height)
    if calibrated != (width, height):
        raise CalibrationError(
            f"calibrated at {calibrated[0]} x {calibrated[1]}, but the camera streams "
            f"{width} x {height}: set camera.width, or calibrate at this resolution"
        )
    age = calibration.age(now)
    if age > max_age:
        raise CalibrationError(
            f"calibrated on {calibration.date:%Y-%m-%d}, {age.days} days ago; more than "
            f"{max_age.days} are not trusted: verify or calibrate again"
        )
    if age < -timedelta(days=1):
        raise CalibrationError(
            f"calibrated on {calibration.date:%Y-%m-%d}, which is in the future: check the clock"
        )
