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

from calibration.depth import DepthModel, DepthQuality
from calibration.solve import HandEye
from calibration.target import CharucoTarget
from calibration.views import Mounting
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

VERSION = 1
MAX_AGE = timedelta(days=90)
Finite = Annotated[float, Field(allow_inf_nan=False)]
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

    def target(self) -> CharucoTarget:
        return CharucoTarget(**self.model_dump(exclude={"scale", "pose"}))


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


class Calibration(_Section):
    """A whole calibration file.

    pose: X_base_camera when eye-to-hand, X_tool_camera when eye-in-hand.
    covariance: of pose, 6 x 6: x, y, z, then rotation vector, along the axes of `parent`.
    record_sha256: of the record that it can be solved from again.
    """

    format: Literal["tdpg-calibration"] = "tdpg-calibration"
    version: int = VERSION
    mounting: Mounting
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
    record_sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Calibration:
        if self.parent != self.mounting.camera_parent:
            raise ValueError(
                f"parent = {self.parent}: {self.mounting.value} means {self.mounting.camera_parent}"
            )
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

    def X_base_camera(self, X_base_tool: Transform | None = None) -> Transform:
        """For eye-in-hand, with the tool where it stood for the picture."""
        if self.mounting is Mounting.EYE_TO_HAND:
            return self.pose.transform()
        if X_base_tool is None:
            raise CalibrationError(
                "this calibration is eye-in-hand: the camera's pose in base needs the tool's"
            )
        return X_base_tool @ self.pose.transform()


def make_calibration(
    found: HandEye,
    target: CharucoTarget,
    *,
    serial: str,
    date: datetime,
    depth: tuple[DepthModel, DepthQuality] | None = None,
    arm_serial: str | None = None,
    record_sha256: str | None = None,
) -> Calibration:
    lens = found.intrinsics
    position_sd, rotation_sd = found.standard_deviations
    return Calibration(
        mounting=found.mounting,
        parent=found.mounting.camera_parent,
        date=date,
        arm_serial=arm_serial,
        camera=CameraSection(
            serial=serial,
            width=lens.width,
            height=lens.height,
            fx=lens.fx,
            fy=lens.fy,
            cx=lens.cx,
            cy=lens.cy,
            distortion=lens.distortion,
            refined=found.lens_refined,
        ),
        pose=PoseSection.of(found.X_parent_camera),
        covariance=tuple(tuple(float(value) for value in row) for row in found.covariance),
        board=BoardSection(
            columns=target.columns,
            rows=target.rows,
            square=target.square,
            marker=target.marker,
            dictionary=target.dictionary,
            legacy=target.legacy,
            scale=found.board_scale,
            pose=PoseSection.of(found.X_parent_board),
        ),
        quality=QualitySection(
            position_sd=position_sd,
            rotation_sd=rotation_sd,
            views_used=sum(view.used for view in found.views),
            views_taken=len(found.views),
            rms_px=found.rms,
            pixel_noise_px=found.pixel_noise,
            arm_noise_position=found.pose_noise.translation,
            arm_noise_rotation=found.pose_noise.rotation,
        ),
        depth=None
        if depth is None
        else DepthSection(
            a=depth[0].a,
            b=depth[0].b,
            offset=depth[1].offset,
            rms=depth[1].rms,
            fill=depth[1].fill,
            left=depth[1].left,
        ),
        record_sha256=record_sha256,
    )


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
    age = (now or datetime.now(timezone.utc)) - calibration.date
    if age > max_age:
        raise CalibrationError(
            f"calibrated on {calibration.date:%Y-%m-%d}, {age.days} days ago; more than "
            f"{max_age.days} are not trusted: verify or calibrate again"
        )
    if age < -timedelta(days=1):
        raise CalibrationError(
            f"calibrated on {calibration.date:%Y-%m-%d}, which is in the future: check the clock"
        )
