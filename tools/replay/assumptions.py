"""What if: another camera pose or cell file in place of the log's. Pure."""

from __future__ import annotations

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError

from tdpg_deploy.cell_config import CellConfig, Metres, Pose
from tdpg_deploy.errors import ConfigError
from tdpg_deploy.geometry import Array

_OFFSET: TypeAdapter[tuple[float, float, float]] = TypeAdapter(
    tuple[Metres, Metres, Metres], config=ConfigDict(allow_inf_nan=False)
)


def parse_offset(text: str) -> Array:
    """ "5 mm,0,0" -> (3,) metres; numbers without a unit are metres. Raises ConfigError."""
    parts = [_number(part) for part in text.split(",")]
    try:
        return np.array(_OFFSET.validate_python(parts))
    except ValidationError as error:
        raise ConfigError(
            f'--move-camera {text!r}: give three lengths along the axes of base, such as "5 mm,0,0"'
        ) from error


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def with_camera_moved(config: CellConfig, offset: Array) -> CellConfig:
    """The cell with its camera's calibrated pose moved by (3,) metres along the axes of base."""
    pose = config.camera.X_base_camera
    x, y, z = (float(value) for value in np.array(pose.position) + offset)
    moved = Pose(position=(x, y, z), quaternion=pose.quaternion)
    camera = config.camera.model_copy(update={"X_base_camera": moved})
    return config.model_copy(update={"camera": camera})
