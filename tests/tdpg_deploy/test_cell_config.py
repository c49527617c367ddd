from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell, parse_cell
from tdpg_deploy.errors import ConfigError

GOOD: dict[str, Any] = {
    "camera": {"X_base_camera": {"position": [0.7, 0, 0.5], "quaternion": [1, 0, 0, 0]}},
    "arm": {"home": ["0 deg", "-90 deg", "90 deg", "-90 deg", "-90 deg", "0 deg"]},
}


def with_field(path: str, value: object) -> dict[str, Any]:
    data = copy.deepcopy(GOOD)
    section = data
    *parents, last = path.split(".")
    for key in parents:
        section = section.setdefault(key, {})
    section[last] = value
    return data


def test_the_shipped_cell_is_valid() -> None:
    assert load_cell(DEFAULT_CELL).name == "mock"


@given(st.floats(-999, 400))
def test_a_unit_is_worth_its_factor(millimetres: float) -> None:
    config = parse_cell(with_field("workspace.table_z", f"{millimetres} mm"))
    assert config.workspace.table_z == pytest.approx(millimetres / 1000, abs=1e-12)


@pytest.mark.parametrize(
    ("field", "text", "si"),
    [
        ("limits.joint_speed", "60 deg/s", np.pi / 3),
        ("limits.acceleration", "1200 mm/s^2", 1.2),
        ("limits.joint_acceleration", "90 deg/s^2", np.pi / 2),
        ("limits.travel_speed", "250 mm/s", 0.25),
        ("gripper.force", "20 N", 20.0),
        ("arm.payload", "925 g", 0.925),
        ("camera.max_frame_age", "500 ms", 0.5),
    ],
)
def test_units_are_read(field: str, text: str, si: float) -> None:
    section, name = field.split(".")
    value = getattr(getattr(parse_cell(with_field(field, text)), section), name)
    assert value == pytest.approx(si)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("workspace.table_z", "3 ft", "units m, cm, mm"),
        ("workspace.table_z", "low", "expected a number"),
        ("limits.joint_speed", 9.0, "less than or equal to 3.14"),
        ("limits.speedy", 1.0, "unknown key"),
        ("gripper.force", 0, "greater than or equal to 10"),
        ("camera.width", 800, "640 or 1280"),
        ("camera.X_base_camera.position", [0, 0, float("nan")], "finite"),
        ("camera.X_base_camera.quaternion", [1, 1, 0, 0], "norm 1, this one 1.414"),
        ("workspace.center", ["700 mm", 0], "reaches 0.85 m"),
        ("arm.home", [0, 0, 0], "missing"),
    ],
)
def test_a_wrong_field_is_named_with_value_and_range(
    field: str, value: object, expected: str
) -> None:
    with pytest.raises(ConfigError) as error:
        parse_cell(with_field(field, value), source="my.toml")
    assert str(error.value).startswith("my.toml: ")
    assert field.split(".")[0] in str(error.value)
    assert expected in str(error.value)


def test_every_wrong_field_is_named_at_once() -> None:
    data = with_field("limits.joint_speed", 9.0)
    data["arm"].pop("home")
    with pytest.raises(ConfigError, match=r"limits.joint_speed.*arm.home|arm.home.*joint_speed"):
        parse_cell(data)


def test_files_that_are_no_cell(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_cell(tmp_path / "absent.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("camera = [")
    with pytest.raises(ConfigError, match="not a TOML file"):
        load_cell(broken)
    broken.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not a TOML file"):
        load_cell(broken)
