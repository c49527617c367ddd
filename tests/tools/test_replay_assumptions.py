"""What if the camera hung elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.errors import ConfigError
from tools.replay.assumptions import parse_offset, with_camera_moved


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("5 mm,0,0", (0.005, 0, 0)),
        ("0,-1.5 cm, 0.002", (0, -0.015, 0.002)),
        ("1e-3,0 m,3mm", (0.001, 0, 0.003)),
    ],
)
def test_offsets_with_and_without_units(text: str, metres: tuple[float, float, float]) -> None:
    assert parse_offset(text) == pytest.approx(metres)


@pytest.mark.parametrize("text", ["", "5 mm", "1,2", "1,2,3,4", "a,b,c", "nan,0,0", "5 deg,0,0"])
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="three lengths along the axes of base"):
        parse_offset(text)


def test_only_the_place_changes() -> None:
    config = load_cell(DEFAULT_CELL)
    moved = with_camera_moved(config, np.array([0.003, -0.004, 0.0]))
    distance, angle = config.X_base_camera.distance(moved.X_base_camera)
    assert distance == pytest.approx(0.005)
    assert angle == 0.0
    shift = moved.X_base_camera.translation - config.X_base_camera.translation
    assert shift == pytest.approx([0.003, -0.004, 0.0])
    restored = with_camera_moved(moved, np.array([-0.003, 0.004, 0.0]))
    assert restored.limits == config.limits
