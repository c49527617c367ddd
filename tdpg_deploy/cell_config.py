"""The cell file: what stands where, and what it may do. TOML in, frozen typed values out.

Lengths, angles, speeds, forces and times are SI numbers, or strings with a unit
("448 mm", "30 deg", "0.25 m/s", "20 N", "500 ms"). See docs/cell-file.md.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from tdpg_deploy.calibration_file import Calibration, load_calibration
from tdpg_deploy.errors import CalibrationError, ConfigError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.kinematics import MODELS, DhParameters

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DEFAULT_CELL = Path(__file__).parent / "cells" / "mock.toml"

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S+)\s*")


def _in_si(**units: float) -> BeforeValidator:
    """Accept a number, or "number unit" with one of `units` (name -> factor to SI)."""
    factors = {name.replace("_per_", "/").replace("2", "^2"): f for name, f in units.items()}

    def convert(value: object) -> object:
        if not isinstance(value, str):
            return value
        match = _QUANTITY.fullmatch(value)
        if match is None or match[2] not in factors:
            raise ValueError(f"expected a number with one of the units {', '.join(factors)}")
        return float(match[1]) * factors[match[2]]

    return BeforeValidator(convert)


_DEG = np.pi / 180
Metres = Annotated[float, _in_si(m=1, cm=1e-2, mm=1e-3)]
Radians = Annotated[float, _in_si(rad=1, deg=_DEG)]
Seconds = Annotated[float, _in_si(s=1, ms=1e-3)]
Newtons = Annotated[float, _in_si(N=1)]
Kilograms = Annotated[float, _in_si(kg=1, g=1e-3)]
MetresPerSecond = Annotated[float, _in_si(m_per_s=1, mm_per_s=1e-3)]
RadiansPerSecond = Annotated[float, _in_si(rad_per_s=1, deg_per_s=_DEG)]
MetresPerSecond2 = Annotated[float, _in_si(m_per_s2=1, mm_per_s2=1e-3)]
RadiansPerSecond2 = Annotated[float, _in_si(rad_per_s2=1, deg_per_s2=_DEG)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _unit_quaternion(xyzw: tuple[float, float, float, float]) -> tuple[float, ...]:
    norm = float(np.linalg.norm(xyzw))
    if abs(norm - 1) > 1e-3:
        raise ValueError(f"a unit quaternion (x, y, z, w) has norm 1, this one {norm:.4f}")
    if abs(norm - 1) < 1e-15:  # a cell that is read back from a log is the same to the last bit
        return xyzw
    return tuple(float(value) for value in np.asarray(xyzw) / norm)


class Pose(_Section):
    """A frame: position, and a unit quaternion x, y, z, w (scalar last)."""

    position: tuple[Metres, Metres, Metres]
    quaternion: Annotated[tuple[float, float, float, float], AfterValidator(_unit_quaternion)] = (
        0.0,
        0.0,
        0.0,
        1.0,
    )

    def transform(self) -> Transform:
        return Transform.from_quaternion(self.position, self.quaternion)


class WorkspaceSection(_Section):
    """The 0.448 m square that is worked on; fixed by 224 pixels of 2 mm."""

    center: tuple[
        Annotated[Metres, Field(ge=-1.0, le=1.0)], Annotated[Metres, Field(ge=-1.0, le=1.0)]
    ] = (0.50, 0.0)
    table_z: Annotated[Metres, Field(ge=-1.0, le=0.5)] = -0.15

    @property
    def x_range(self) -> tuple[float, float]:
        return self.center[0] - WORKSPACE_SIDE / 2, self.center[0] + WORKSPACE_SIDE / 2

    @property
    def y_range(self) -> tuple[float, float]:
        return self.center[1] - WORKSPACE_SIDE / 2, self.center[1] + WORKSPACE_SIDE / 2


class BinSection(_Section):
    """Where held objects are let go: the tool's place above the bin, out of the camera's way."""

    position: tuple[Metres, Metres, Metres] = (0.20, -0.50, 0.05)


DepthPreset = Literal["default", "hand", "high accuracy", "high density", "medium density"]


class CameraSection(_Section):
    """The D435. X_base_camera: its pose, optical axes, z forward; a cell file gives it, or names
    a calibration file that holds it."""

    driver: Literal["realsense"] = "realsense"
    serial: str | None = None
    width: Literal[640, 1280] = 1280
    X_base_camera: Pose
    calibration: Calibration | None = None
    max_frame_age: Annotated[Seconds, Field(gt=0, le=5)] = 0.5
    frames_averaged: Annotated[int, Field(ge=1, le=60)] = 1
    fps: Literal[6, 15, 30] = 30
    preset: DepthPreset | None = None  # leaves the camera as it is
    emitter: bool = True  # the projector of dots
    filters: tuple[Literal["spatial", "temporal", "hole filling"], ...] = ()  # of librealsense
    recording: str | None = None  # played back in place of a camera
    emulated: tuple[str, Annotated[int, Field(ge=1, le=65535)]] | None = None  # by tdpg-emulate

    @property
    def height(self) -> int:
        return {640: 480, 1280: 720}[self.width]


class ArmSection(_Section):
    """The UR5 or UR5e. `X_flange_tool` puts the tool between the closed finger tips."""

    driver: Literal["ur"] = "ur"
    model: Literal["ur5", "ur5e"] = "ur5"
    host: str = "192.168.0.2"
    X_flange_tool: Pose = Pose(position=(0.0, 0.0, 0.163))
    payload: Annotated[Kilograms, Field(ge=0, le=5)] = 0.925
    home: tuple[Radians, Radians, Radians, Radians, Radians, Radians]

    @property
    def dh(self) -> DhParameters:
        return MODELS[self.model]


class GripperSection(_Section):
    """The Robotiq 2F-85 and the wire that it hangs on."""

    driver: Literal["robotiq_rtu", "robotiq_rtu_tcp", "robotiq_urcap"] = "robotiq_urcap"
    port: str | None = None  # /dev/serial/by-id/... for robotiq_rtu
    host: str | None = None  # defaults to the arm's host
    tcp_port: Annotated[int, Field(ge=1, le=65535)] | None = None  # defaults to the driver's
    unit_id: Annotated[int, Field(ge=1, le=247)] = 9
    open_counts: Annotated[int, Field(ge=0, le=50)] = 3  # gPO when open; differs per gripper
    closed_counts: Annotated[int, Field(ge=180, le=255)] = 228  # gPO when closed on nothing
    force: Annotated[Newtons, Field(ge=10, le=235)] = 20.0
    speed: Annotated[MetresPerSecond, Field(gt=0, le=0.15)] = 0.10

    @model_validator(mode="after")
    def _serial_line_named(self) -> GripperSection:
        if self.driver == "robotiq_rtu" and self.port is None:
            raise ValueError('robotiq_rtu needs port = "/dev/serial/by-id/..."')
        return self


class Limits(_Section):
    """What no plan may exceed, and what `check` refuses."""

    joint_speed: Annotated[RadiansPerSecond, Field(gt=0, le=3.14)] = 1.05
    joint_acceleration: Annotated[RadiansPerSecond2, Field(gt=0, le=10)] = 1.4
    travel_speed: Annotated[MetresPerSecond, Field(gt=0, le=1.0)] = 0.5
    contact_speed: Annotated[MetresPerSecond, Field(gt=0, le=0.25)] = 0.15
    touch_speed: Annotated[MetresPerSecond, Field(gt=0, le=0.25)] = 0.05
    acceleration: Annotated[MetresPerSecond2, Field(gt=0, le=5)] = 1.2
    descend_force: Annotated[Newtons, Field(ge=5, le=80)] = 15.0
    push_force: Annotated[Newtons, Field(ge=5, le=100)] = 50.0
    table_clearance: Annotated[Metres, Field(ge=0.001, le=0.05)] = 0.004
    travel_height: Annotated[Metres, Field(ge=0.1, le=0.5)] = 0.25
    # How far around the workspace the table is known to be clear, so that a finger may go there.
    workspace_margin: Annotated[Metres, Field(ge=0, le=0.1)] = 0.0
    joint_range: tuple[Radians, Radians] = (-2 * np.pi, 2 * np.pi)


class EpisodeSection(_Section):
    """When an episode ends."""

    max_failures: Annotated[int, Field(ge=1, le=1000)] = 10  # in a row (paper, section IV)
    max_actions: Annotated[int, Field(ge=1, le=100_000)] = 200


def _carrier(name: object) -> object:
    """Cells that were logged before `arm.model` knew the UR5e call the arm "ur5"."""
    return "arm" if name == "ur5" else name


class SimulationSection(_Section):
    """The mock cell only: what is true there, and how it is simulated."""

    carrier: Annotated[Literal["arm", "gantry"], BeforeValidator(_carrier)] = "arm"
    depth_noise: bool = True
    friction: Annotated[float, Field(ge=0.1, le=2)] = 0.6  # of blocks; Bullet multiplies a pair's
    density: Annotated[float, Field(ge=50, le=5000)] = 650.0  # kg/m^3, beech wood
    light: tuple[float, float, float] = (0.4, 0.5, 1.0)  # direction towards the lamp, base frame
    table_tags: bool = False  # glued around the workspace, for the camera to know its place by
    X_base_camera: Pose | None = None  # true pose; the calibrated one when absent


class CellConfig(_Section):
    """A whole cell file."""

    name: str = "cell"
    workspace: WorkspaceSection = WorkspaceSection()
    bin: BinSection = BinSection()
    camera: CameraSection
    arm: ArmSection
    gripper: GripperSection = GripperSection()
    limits: Limits = Limits()
    episode: EpisodeSection = EpisodeSection()
    simulation: SimulationSection = SimulationSection()

    @model_validator(mode="after")
    def _workspace_in_reach(self) -> CellConfig:
        x, y = self.workspace.center
        half = WORKSPACE_SIDE / 2
        farthest = float(np.hypot(abs(x) + half, abs(y) + half))
        if farthest > REACH:
            raise ValueError(
                f"workspace.center = ({x}, {y}) m puts a corner {farthest:.3f} m from the base; "
                f"a {self.arm.dh.name} reaches {REACH} m: move the workspace closer"
            )
        return self

    @property
    def X_base_camera(self) -> Transform:
        return self.camera.X_base_camera.transform()


WORKSPACE_SIDE = 0.448  # m, 224 pixels of 2 mm (paper, sections III and IV)
REACH = 0.85  # m, UR5 and UR5e user manuals, "working radius"


def parse_cell(data: dict[str, Any], *, source: str = "cell") -> CellConfig:
    """Validate a cell file's content. Raises ConfigError that names every wrong field."""
    try:
        return CellConfig.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"{source}: {_explain(error)}") from error


def load_cell(path: Path) -> CellConfig:
    """Read a TOML cell file, and the calibration that it names. Raises ConfigError."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not a TOML file: {error}") from error
    camera = data.get("camera")
    if isinstance(camera, dict) and isinstance(camera.get("calibration"), str):
        data["camera"] = _calibrated(camera, path)
    return parse_cell(data, source=str(path))


def _calibrated(camera: dict[str, Any], source: Path) -> dict[str, Any]:
    """The camera's table with the calibration read from beside the cell file, and its pose."""
    if "X_base_camera" in camera:
        raise ConfigError(
            f"{source}: camera.calibration and camera.X_base_camera are both given: remove "
            "X_base_camera, the calibration holds it"
        )
    try:
        calibration = load_calibration(source.parent / camera["calibration"])
    except CalibrationError as error:
        raise ConfigError(f"{source}: camera.calibration: {error}") from error
    if calibration.mounting != "eye-to-hand":
        raise ConfigError(
            f"{source}: camera.calibration is {calibration.mounting}; a fixed camera is needed: "
            "calibrate eye-to-hand"
        )
    pose = Pose(position=calibration.pose.position, quaternion=calibration.pose.quaternion)
    return {**camera, "calibration": calibration, "X_base_camera": pose}


def _explain(error: ValidationError) -> str:
    lines = []
    for problem in error.errors():
        field = ".".join(str(part) for part in problem["loc"]) or "cell"
        if problem["type"] == "extra_forbidden":
            lines.append(f"{field}: unknown key; docs/cell-file.md lists what exists")
        elif problem["type"] == "missing":
            lines.append(f"{field}: missing")
        else:
            message = problem["msg"].removeprefix("Value error, ")
            shown = "" if isinstance(problem["input"], dict) else f" = {problem['input']!r}"
            lines.append(f"{field}{shown}: {message}")
    return "; ".join(lines)
