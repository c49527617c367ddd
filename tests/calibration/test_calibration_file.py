"""The file, its strictness, and other programs' formats."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from calibration.exchange import (
    export_easy_handeye,
    export_ros,
    export_vpg,
    import_easy_handeye,
    import_vpg,
)
from calibration.file import make_calibration
from calibration.folder import read_lens, read_poses
from calibration.refine import Freedom
from calibration.solve import solve
from calibration.synthetic import make_truth, observe
from calibration.target import DEFAULT_TARGET
from calibration.views import Mounting
from tdpg_deploy.calibration_file import (
    Calibration,
    check_applies,
    load_calibration,
    save_calibration,
)
from tdpg_deploy.errors import CalibrationError

DATE = datetime(2026, 5, 4, 12, tzinfo=timezone.utc)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    rng = np.random.default_rng(0)
    corners = DEFAULT_TARGET.corners()
    truth = make_truth(Mounting.EYE_TO_HAND, corners, rng)
    views = observe(truth, 12, rng)
    found = solve(views, corners, truth.intrinsics, truth.mounting, freedoms=[Freedom()])
    return make_calibration(found, DEFAULT_TARGET, serial="8323", date=DATE)


def test_written_and_read_back(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    save_calibration(calibration, path)
    again = load_calibration(path)
    assert again == calibration
    np.testing.assert_array_equal(
        again.pose.transform().translation, calibration.pose.transform().translation
    )
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 2}, "format version 2"),
        ({"format": "other"}, "not a calibration of this project"),
        ({"mounting": "eye-in-hand"}, "eye-in-hand means tool"),
        ({"surprise": 1}, "surprise"),
        ({"covariance": [[1.0]]}, "6 x 6"),
        ({"pose": {"position": [0, 0, 1], "quaternion": [0, 0, 0, 2]}}, "norm 2.0000"),
        ({"pose": {"position": [0, 0, ".nan"], "quaternion": [0, 0, 0, 1]}}, "position"),
        ({"date": "2026-05-04T12:00:00"}, "time zone"),
        ({"units": "mm, deg, px"}, "units"),
    ],
)
def test_a_wrong_file_is_refused(
    calibration: Calibration, tmp_path: Path, change: dict[str, object], message: str
) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(yaml.safe_dump({**calibration.model_dump(mode="json"), **change}))
    with pytest.raises(CalibrationError, match=message):
        load_calibration(path)


@pytest.mark.parametrize("text", ["[1, 2]", "a: [", "!!python/object:os.system {}", ""])
def test_garbage_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=r"calibration\.yaml"):
        load_calibration(path)
    with pytest.raises(CalibrationError, match="cannot be read"):
        load_calibration(tmp_path / "missing.yaml")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"serial": "9999"}, "camera 8323, but 9999"),
        ({"width": 640, "height": 480}, "1280 x 720, but the camera streams 640 x 480"),
        ({"now": DATE + timedelta(days=91)}, "91 days ago"),
        ({"now": DATE - timedelta(days=3)}, "in the future"),
    ],
)
def test_what_does_not_apply_is_refused(
    calibration: Calibration, arguments: dict[str, object], message: str
) -> None:
    fitting = {"serial": "8323", "width": 1280, "height": 720, "now": DATE + timedelta(days=1)}
    check_applies(calibration, **fitting)  # type: ignore[arg-type]
    with pytest.raises(CalibrationError, match=message):
        check_applies(calibration, **{**fitting, **arguments})  # type: ignore[arg-type]


def test_easy_handeye_and_back(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "easy.yaml"
    path.write_text(export_easy_handeye(calibration))
    pose = import_easy_handeye(path)
    assert pose.mounting is Mounting.EYE_TO_HAND
    distance, angle = pose.X_parent_camera.distance(calibration.pose.transform())
    assert max(distance, angle) < 1e-9
    path.write_text("parameters: {}\n")
    with pytest.raises(CalibrationError, match="not easy_handeye's format"):
        import_easy_handeye(path)


def test_vpg_and_back(calibration: Calibration, tmp_path: Path) -> None:
    pose_text, scale_text = export_vpg(calibration)
    (tmp_path / "camera_pose.txt").write_text(pose_text)
    (tmp_path / "camera_depth_scale.txt").write_text(scale_text)
    pose = import_vpg(tmp_path / "camera_pose.txt", tmp_path / "camera_depth_scale.txt")
    distance, angle = pose.X_parent_camera.distance(calibration.pose.transform())
    assert max(distance, angle) < 1e-9
    assert pose.depth_scale == 1.0
    (tmp_path / "camera_pose.txt").write_text("1 2 3\n")
    with pytest.raises(CalibrationError, match="3 numbers"):
        import_vpg(tmp_path / "camera_pose.txt")


def test_ros_names_both_frames(calibration: Calibration) -> None:
    text = export_ros(calibration)
    assert "--frame-id base --child-frame-id camera_color_optical_frame" in text


# --- somebody else's pictures and poses -------------------------------------------------------


def test_pose_tables_in_both_forms(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("# ours\nimage,x,y,z,rx,ry,rz\na.png,0.1,0.2,0.3,0.4,0.5,0.6\n")
    X = read_poses(path)["a.png"]
    np.testing.assert_allclose(X.as_rotation_vector(), [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    q = Rotation.from_rotvec([0.4, 0.5, 0.6]).as_quat()
    path.write_text("image,x,y,z,qx,qy,qz,qw\na.png,0.1,0.2,0.3," + ",".join(map(str, q)) + "\n")
    assert max(read_poses(path)["a.png"].distance(X)) < 1e-9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("image,x,y,z,rx,ry,rz\na.png,400,100,300,0,3,0\n", "are the poses in mm"),
        ("image,x,y,z,rx,ry,rz\na.png,0.4,0.1,0.3,0,175,0\n", "degrees"),
        ("image,x,y,z,qx,qy,qz,qw\na.png,0.4,0.1,0.3,1,1,0,0\n", "norm 1.414"),
        ("image,x,y,z\na.png,0.4,0.1,0.3\n", "its header is"),
        ("image,x,y,z,rx,ry,rz\na.png,0.4,0.1,0.3,0,1\n", "needs 6 numbers"),
        ("image,x,y,z,rx,ry,rz\na.png,0,0,0,0,1,0\na.png,0,0,0,0,1,0\n", "two poses"),
        ("image,x,y,z,rx,ry,rz\n", "has no poses"),
        ("image,x,y,z,rx,ry,rz\na.png,nan,0,0,0,1,0\n", "nan"),
        ("", "its header is"),
    ],
)
def test_mistakes_in_pose_tables_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=message):
        read_poses(path)


def test_lens_files(tmp_path: Path) -> None:
    path = tmp_path / "lens.yaml"
    path.write_text("width: 640\nheight: 480\nfx: 600\nfy: 601\ncx: 320\ncy: 240\n")
    assert read_lens(path).fy == 601.0
    path.write_text(
        "image_width: 640\nimage_height: 480\n"
        "camera_matrix: {data: [600, 0, 320, 0, 601, 240, 0, 0, 1]}\n"
        "distortion_coefficients: {data: [0.1, 0.01, 0, 0, 0]}\n"
    )
    assert read_lens(path).distortion[0] == 0.1
    path.write_text("width: 640\n")
    with pytest.raises(CalibrationError, match="height"):
        read_lens(path)
