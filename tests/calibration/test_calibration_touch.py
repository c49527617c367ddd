"""The tool comes down on blocks, in the mock cell, whose camera stands where it should or not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from board_in_cell import with_true_camera

from calibration.cli import main
from calibration.touch import Touch, find_places, plan_touch, touch_all
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.emulators.cell_file import format_cell
from tdpg_deploy.errors import CalibrationError, PlanRefused
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.plan import MoveLinear

MOCK = load_cell(DEFAULT_CELL)
TOPS = [(0.42, -0.10), (0.58, -0.10), (0.50, 0.0), (0.42, 0.12), (0.60, 0.13), (0.48, -0.16)]
HEIGHT = 0.05  # m of a cube
TOP_Z = MOCK.workspace.table_z + HEIGHT


def seen_tops(rng: np.random.Generator, tops: list[tuple[float, float]]) -> Array:
    """(n, 3) as a camera would see cubes on a table: a point every 1.5 mm, with 0.8 mm of noise."""
    side = np.arange(-0.22, 0.22, 0.0015)
    x, y = np.meshgrid(0.5 + side, side)
    z = np.full(x.shape, MOCK.workspace.table_z)
    for a, b in tops:
        z[np.maximum(abs(x - a), abs(y - b)) < 0.025] = TOP_Z
    z += rng.normal(0, 0.8e-3, z.shape)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def test_places_are_on_the_tops_and_apart() -> None:
    places = find_places(seen_tops(np.random.default_rng(0), TOPS), MOCK)
    assert len(places) >= len(TOPS)
    on = [int(np.linalg.norm(np.array(TOPS) - place[:2], axis=1).argmin()) for place in places]
    assert set(on) == set(range(len(TOPS)))
    for place, i in zip(places, on, strict=True):
        assert np.abs(place[:2] - TOPS[i]).max() < 0.015
        assert place[2] == pytest.approx(TOP_Z, abs=1e-3)


def test_too_few_places_are_refused() -> None:
    points = seen_tops(np.random.default_rng(0), TOPS[:3])
    with pytest.raises(CalibrationError, match=r"3 flat places .* lay blocks or books"):
        find_places(points, MOCK)


def test_every_touch_passes_the_check_and_stops_on_force() -> None:
    steps = plan_touch(np.array([0.5, 0.1, TOP_Z]), MOCK)
    linear = [step for step in steps if isinstance(step, MoveLinear)]
    assert all(step.stop_force is not None for step in linear)
    lowest = min(step.X_base_tool.translation[2] for step in linear)
    assert lowest == pytest.approx(TOP_Z - 0.015)
    (slow,) = [step for step in linear if step.name == "touch"]
    assert slow.speed == 0.01
    with pytest.raises(PlanRefused):
        plan_touch(np.array([0.9, 0.6, TOP_Z]), MOCK)


def scene(directory: Path) -> Path:
    objects = [
        f'[[object]]\nshape = "cube"\nposition = [{x}, {y}, {TOP_Z - HEIGHT / 2}]\n'
        "quaternion = [0.0, 0.0, 0.0, 1.0]\nrgb = [225, 87, 89]\n"
        for x, y in TOPS
    ]
    head = 'version = 1\nframe = "base"\nlength = "m"\nquaternion = "xyzw"\n'
    path = directory / "scene.toml"
    path.write_text(head + "".join(objects))
    return path


def run_touch(directory: Path, config: CellConfig) -> int:
    cell = directory / "cell.toml"
    cell.write_text(format_cell(config))
    return main(["touch", "--config", str(cell), "--scene", str(scene(directory))])


@pytest.mark.slow
def test_a_camera_that_stands_right_and_one_that_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right = MOCK.X_base_camera
    assert run_touch(tmp_path, with_true_camera(MOCK, right)) == 0
    assert "median" in capsys.readouterr().out
    # A camera that really stands 8 mm lower sees everything 8 mm higher than it is.
    lower = Transform(right.rotation, right.translation - [0, 0, 0.008])
    assert run_touch(tmp_path, with_true_camera(MOCK, lower)) == 1
    said = capsys.readouterr().out
    errors = [
        float(line.split("met ")[1].split(" mm")[0])
        for line in said.splitlines()
        if "from where seen" in line
    ]
    assert len(errors) >= 5
    assert errors == pytest.approx([-8.0] * len(errors), abs=1.0)


def test_too_few_touches_are_no_test() -> None:
    touches: list[Touch] = []
    far = [np.array([0.9, 0.6, TOP_Z])] * 5
    with open_cell(MOCK) as cell:
        with pytest.raises(CalibrationError, match="0 places could be touched"):
            touch_all(far, cell.arm, cell.gripper, MOCK, touches.append)
        assert cell.arm.state().q == pytest.approx(np.array(MOCK.arm.home), abs=1e-3)
    assert not touches
