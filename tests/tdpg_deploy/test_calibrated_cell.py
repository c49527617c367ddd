"""A cell file that names its calibration: what is taken from it, and what stops before a motion."""

from __future__ import annotations

import json
import re
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

from calibration.drift import find_tags
from tdpg_deploy.calibration_file import Calibration, save_calibration
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell, parse_cell
from tdpg_deploy.cli.run import main
from tdpg_deploy.cli.session import describe_calibration
from tdpg_deploy.emulators.cell_file import format_cell
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.errors import ConfigError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.sim.camera import COLOR_1280

EMPTY_SCENE = 'version = 1\nframe = "base"\nlength = "m"\nquaternion = "xyzw"\n'
MOCK = load_cell(DEFAULT_CELL)


def calibration(**changes: object) -> Calibration:
    """Of the mock cell's camera, with depth 1 % too long and a lens 1 % longer than it says."""
    pose = MOCK.camera.X_base_camera.model_dump()
    lens = COLOR_1280
    data = {
        "mounting": "eye-to-hand",
        "parent": "base",
        "date": datetime.now(timezone.utc) - timedelta(days=3),
        "camera": {
            "serial": "simulated",
            "width": 1280,
            "height": 720,
            "fx": 1.01 * lens.fx,
            "fy": lens.fy,
            "cx": lens.cx,
            "cy": lens.cy,
            "distortion": [0.0] * 5,
            "refined": True,
        },
        "pose": pose,
        "covariance": (1e-8 * np.eye(6)).tolist(),
        "board": {
            "columns": 9,
            "rows": 6,
            "square": 0.028,
            "marker": 0.021,
            "dictionary": "DICT_5X5_100",
            "legacy": False,
            "scale": 1.0,
            "pose": pose,
        },
        "quality": {
            "position_sd": 1.2e-4,
            "rotation_sd": 1e-4,
            "views_used": 14,
            "views_taken": 15,
            "rms_px": 0.1,
            "pixel_noise_px": 0.1,
            "arm_noise_position": 3e-5,
            "arm_noise_rotation": 5e-5,
        },
        "depth": {"a": 1.01, "b": 0.0, "offset": 0.007, "rms": 1e-3, "fill": 1.0, "left": 0.0},
    }
    return Calibration.model_validate({**data, **changes})


def true_calibration(**changes: object) -> Calibration:
    """Of the mock cell's camera as it is."""
    camera = {**calibration().camera.model_dump(), "fx": COLOR_1280.fx, "refined": False}
    return calibration(depth=None, camera=camera, **changes)


def cell_file(directory: Path, made: Calibration) -> Path:
    save_calibration(made, directory / "calibration.yaml")
    lines = DEFAULT_CELL.read_text().splitlines()
    text = "\n".join(
        'calibration = "calibration.yaml"' if line.startswith("X_base_camera") else line
        for line in lines
    )
    path = directory / "cell.toml"
    path.write_text(text)
    return path


def configured(made: Calibration) -> CellConfig:
    camera = MOCK.camera.model_copy(update={"calibration": made})
    simulation = MOCK.simulation.model_copy(update={"depth_noise": False})
    return MOCK.model_copy(update={"camera": camera, "simulation": simulation})


def test_its_pose_is_the_cells(tmp_path: Path) -> None:
    made = calibration(pose={"position": [0.7, 0.01, 0.6], "quaternion": [0.6, 0.8, 0.0, 0.0]})
    config = load_cell(cell_file(tmp_path, made))
    assert config.camera.calibration == made
    expected = Transform.from_quaternion([0.7, 0.01, 0.6], [0.6, 0.8, 0.0, 0.0])
    assert max(config.X_base_camera.distance(expected)) < 1e-12


def test_a_logged_or_written_cell_is_the_same_when_read(tmp_path: Path) -> None:
    tags = {7: [[1.5, 2.0], [3.0, 2.0], [3.0, 4.0], [1.0, 4.0]]}
    config = load_cell(cell_file(tmp_path, calibration(tags=tags)))
    assert parse_cell(json.loads(config.model_dump_json())) == config
    written = tmp_path / "written.toml"
    written.write_text(format_cell(config))
    assert load_cell(written) == config


def test_two_poses_are_refused(tmp_path: Path) -> None:
    path = cell_file(tmp_path, calibration())
    pose = 'X_base_camera = { position = [0, 0, 1] }\ncalibration = "calibration.yaml"'
    path.write_text(path.read_text().replace('calibration = "calibration.yaml"', pose))
    with pytest.raises(ConfigError, match="are both given: remove X_base_camera"):
        load_cell(path)


def test_a_missing_calibration_is_refused(tmp_path: Path) -> None:
    path = cell_file(tmp_path, calibration())
    (tmp_path / "calibration.yaml").unlink()
    with pytest.raises(ConfigError, match=r"calibration\.yaml: cannot be read .* `tdpg-calibrate`"):
        load_cell(path)


def test_a_camera_on_the_tool_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is eye-in-hand; a fixed camera is needed"):
        load_cell(cell_file(tmp_path, calibration(mounting="eye-in-hand", parent="tool")))


def test_frames_are_put_right() -> None:
    """Against the same camera without a calibration: 1 % of depth, and the refined lens."""
    with open_cell(configured(calibration())) as cell:
        right = cell.camera.capture()
        assert cell.camera.intrinsics == right.intrinsics
    with open_cell(configured(calibration()).model_copy(update={"camera": MOCK.camera})) as cell:
        raw = cell.camera.capture()
    known = np.isfinite(raw.depth)
    np.testing.assert_allclose(right.depth[known], raw.depth[known] / 1.01, rtol=1e-6)
    assert np.isnan(right.depth[~known]).all()
    assert right.intrinsics.fx == pytest.approx(1.01 * raw.intrinsics.fx)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"date": datetime.now(timezone.utc) - timedelta(days=91)}, "91 days ago"),
        (
            {"camera": {**calibration().camera.model_dump(), "serial": "8323"}},
            "camera 8323, but simulated is connected",
        ),
        (
            {"camera": {**calibration().camera.model_dump(), "width": 640, "height": 480}},
            "640 x 480, but the camera streams 1280 x 720",
        ),
        (
            {"tags": {i: [[0, 0], [9, 0], [9, 9], [0, 9]] for i in range(4)}},
            "0 of 4 table tags are seen",
        ),
    ],
)
def test_what_does_not_apply_stops_a_run_before_anything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, object], message: str
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(EMPTY_SCENE)
    path = cell_file(tmp_path, calibration(**changes))
    arguments = ["--config", str(path), "--scene", str(scene), "--out", str(tmp_path)]
    assert main(["--policy", "random", *arguments]) == 2
    assert message in capsys.readouterr().out.replace("\n", " ")
    assert not list(tmp_path.glob("*.mcap*"))  # no episode was begun


def test_what_applies_is_used_and_logged(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(EMPTY_SCENE)
    made = true_calibration()
    path = cell_file(tmp_path, made)
    arguments = ["--config", str(path), "--scene", str(scene), "--out", str(tmp_path)]
    assert main(["--policy", "random", *arguments]) == 0
    (log,) = tmp_path.glob("*.mcap")
    assert read_episode(log).about.cell.camera.calibration == made


def table_tags() -> dict[int, list[list[float]]]:
    """Where the mock cell's camera sees the four tags that a cell file may ask for."""
    tagged = MOCK.simulation.model_copy(update={"table_tags": True})
    with open_cell(MOCK.model_copy(update={"simulation": tagged})) as cell:
        found = find_tags(cell.camera.capture().color).corners
    return {number: corners.tolist() for number, corners in found.items()}


def run_tagged(directory: Path, made: Calibration, simulation: str) -> int:
    """tdpg-run on an empty mock table with tags; simulation: more of that section."""
    scene = directory / "scene.toml"
    scene.write_text(EMPTY_SCENE)
    path = cell_file(directory, made)
    path.write_text(f"{path.read_text()}\n[simulation]\ntable_tags = true\n{simulation}")
    out = ["--out", str(directory)]
    return main(["--policy", "random", "--config", str(path), "--scene", str(scene), *out])


def test_a_camera_that_stands_still_runs(tmp_path: Path) -> None:
    tags = table_tags()
    assert sorted(tags) == [0, 1, 2, 3]
    assert run_tagged(tmp_path, true_calibration(tags=tags), "") == 0
    assert list(tmp_path.glob("*.mcap"))


@pytest.mark.parametrize("axis", range(3))
def test_a_camera_that_was_moved_stops_a_run_before_anything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], axis: int
) -> None:
    """By 2 mm along an axis of base; only the simulated world knows."""
    pose = MOCK.camera.X_base_camera
    position = np.array(pose.position) + 2e-3 * np.eye(3)[axis]
    moved = f"position = {position.tolist()}, quaternion = {list(pose.quaternion)}"
    made = true_calibration(tags=table_tags())
    assert run_tagged(tmp_path, made, f"X_base_camera = {{ {moved} }}") == 2
    said = capsys.readouterr().out.replace("\n", " ")
    assert re.search(r"table tags have moved by [12]\.\d+ px since the calibration", said)
    assert not list(tmp_path.glob("*.mcap*"))  # no episode was begun


def test_consent_says_how_the_pose_is_known() -> None:
    assert "typed into the cell file" in describe_calibration(MOCK)
    said = describe_calibration(configured(calibration()))
    assert "calibrated 3 days ago to 0.12 mm; no table tags" in said
