"""Somebody else's pictures and poses through the command line: every format, every mistake."""

from __future__ import annotations

import csv
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from calibration.cli import main
from calibration.pictures import paint_board
from calibration.synthetic import Truth, make_truth, observe
from calibration.target import DEFAULT_TARGET
from calibration.views import Mounting, PoseNoise
from tdpg_deploy.calibration_file import load_calibration
from tdpg_deploy.geometry import Transform
from tools.benchmark.calibration_checks import X_CAMERA_TABLE, draw

Picture = npt.NDArray[np.uint8]
VIEWS = 10


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """What somebody recorded: pictures and the tool's poses."""

    truth: Truth
    pictures: Sequence[Picture]
    poses: Sequence[Transform]


@pytest.fixture(scope="module")
def shot() -> Shot:
    rng = np.random.default_rng(4)
    truth = make_truth(Mounting.EYE_TO_HAND, DEFAULT_TARGET.corners(), rng)
    still = PoseNoise(translation=0.0, rotation=0.0)
    views = observe(truth, VIEWS, rng, pose_noise=still)
    pictures = []
    for view in views:
        X_camera_board = truth.X_parent_camera.inverse() @ view.X_base_tool @ truth.X_parent_board
        grey = np.full((720, 1280, 3), 110, np.uint8)
        picture = paint_board(grey, DEFAULT_TARGET, X_camera_board, truth.intrinsics)[..., 0]
        noise = rng.normal(0, 3, picture.shape)
        pictures.append((picture + noise).clip(0, 255).astype(np.uint8))
    return Shot(truth=truth, pictures=pictures, poses=[view.X_base_tool for view in views])


def vectors(poses: Sequence[Transform]) -> list[list[float]]:
    return [pose.as_rotation_vector().tolist() for pose in poses]


def quaternions(poses: Sequence[Transform]) -> list[list[float]]:
    return [[*pose.translation.tolist(), *pose.as_quaternion().tolist()] for pose in poses]


def write_poses(path: Path, names: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
    axes = ["rx", "ry", "rz"] if len(rows[0]) == 6 else ["qx", "qy", "qz", "qw"]
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["image", "x", "y", "z", *axes])
        table.writerows([name, *row] for name, row in zip(names, rows, strict=True))


def write_folder(
    path: Path,
    shot: Shot,
    *,
    rows: Sequence[Sequence[float]] | None = None,
    pictures: Sequence[Picture] | None = None,
    suffix: str = ".png",
) -> list[str]:
    """The arguments that name what was written."""
    pictures = shot.pictures if pictures is None else pictures
    names = [f"{i:03d}{suffix}" for i in range(len(pictures))]
    for name, picture in zip(names, pictures, strict=True):
        cv2.imwrite(str(path / name), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    write_poses(path / "poses.csv", names, rows or vectors(shot.poses))
    k = shot.truth.intrinsics
    (path / "lens.yaml").write_text(
        f"width: 1280\nheight: 720\nfx: {k.fx}\nfy: {k.fy}\ncx: {k.cx}\ncy: {k.cy}\n"
    )
    found = ["--images", str(path), "--poses", str(path / "poses.csv")]
    outputs = ["--out", str(path / "calibration.yaml"), "--report", str(path / "page.html")]
    return ["solve", *found, "--lens", str(path / "lens.yaml"), *outputs]


def run(capsys: pytest.CaptureFixture[str], arguments: Sequence[str]) -> tuple[int, str]:
    """Exit code, and what was said, without its line breaks."""
    capsys.readouterr()
    code = main(list(arguments))
    return code, " ".join(capsys.readouterr().out.split())


def error_mm(shot: Shot, path: Path) -> float:
    pose = load_calibration(path / "calibration.yaml").pose.transform()
    return 1e3 * shot.truth.X_parent_camera.distance(pose)[0]


def blurred(picture: Picture) -> Picture:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 4), np.uint8)


def dark(picture: Picture) -> Picture:
    return (picture * 0.15).astype(np.uint8)


def partial(picture: Picture) -> Picture:
    """All but a third of the board is covered by something grey."""
    covered = picture.copy()
    board = np.nonzero(picture > 200)[1]
    covered[:, round(float(np.quantile(board, 0.3))) :] = 110
    return covered


@pytest.mark.slow
def test_a_calibration_and_its_page(
    shot: Shot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One picture is blurred, one dark, one partial: each is named, the rest suffices."""
    spoiled = {3: blurred, 5: dark, 8: partial}
    pictures = [spoiled.get(i, lambda p: p)(p) for i, p in enumerate(shot.pictures)]
    cv2.imwrite(str(tmp_path / "table.png"), np.asarray(draw(X_CAMERA_TABLE), np.uint8))
    arguments = [*write_folder(tmp_path, shot, pictures=pictures), "--serial", "83"]
    code, said = run(capsys, [*arguments, "--table", str(tmp_path / "table.png")])
    assert code == 0
    assert "003.png: blurred" in said
    assert "005.png: dark" in said
    assert "008.png: partial" in said
    calibration = load_calibration(tmp_path / "calibration.yaml")
    assert sorted(calibration.tags) == [0, 1, 2, 3]
    assert error_mm(shot, tmp_path) < 0.25
    assert error_mm(shot, tmp_path) < 4e3 * calibration.quality.position_sd
    page = (tmp_path / "page.html").read_text()
    assert page.count("<svg") == 4  # coverage, residuals, workspace, views
    assert "data:image/png;base64," in page
    assert 'src="http' not in page
    assert "003.png" in page
    assert run(capsys, ["verify", str(tmp_path / "calibration.yaml"), "--serial", "7"])[0] == 1


@pytest.mark.slow
def test_the_other_formats(shot: Shot, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """JPEG, quaternions, ROS's camera_info, comments and a byte order mark."""
    arguments = write_folder(tmp_path, shot, rows=quaternions(shot.poses), suffix=".jpg")
    poses = tmp_path / "poses.csv"
    poses.write_text("\ufeff# from my robot\n\n" + poses.read_text().replace(",", ", "))
    k = shot.truth.intrinsics
    (tmp_path / "lens.yaml").write_text(
        "image_width: 1280\nimage_height: 720\ncamera_name: color\n"
        f"camera_matrix: {{rows: 3, cols: 3, data: [{k.fx}, 0, {k.cx}, 0, {k.fy}, {k.cy}, "
        "0, 0, 1]}\ndistortion_model: plumb_bob\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    )
    code, _ = run(capsys, arguments)
    assert code == 0
    assert error_mm(shot, tmp_path) < 0.3


def in_degrees(poses: Sequence[Transform]) -> list[list[float]]:
    return [[*row[:3], *np.rad2deg(row[3:])] for row in vectors(poses)]


MISTAKES: dict[str, tuple[Callable[[Sequence[Transform]], list[list[float]]], str]] = {
    "inverted": (lambda X: vectors([x.inverse() for x in X]), "the poses are inverted"),
    "reversed": (lambda X: vectors(X[::-1]), "in reverse order"),
    "shifted": (lambda X: vectors([*X[1:], X[0]]), "shifted by one"),
    "shuffled": (
        lambda X: vectors([X[i] for i in np.random.default_rng(0).permutation(len(X))]),
        "the poses are out of order",
    ),
    "millimetres": (
        lambda X: [[*(1e3 * x.translation), *x.rotation.as_rotvec()] for x in X],
        "are the poses in mm",
    ),
    "degrees": (in_degrees, "is it in degrees"),
    "scalar first": (
        lambda X: [[*row[:3], row[6], *row[3:6]] for row in quaternions(X)],
        "quaternions are read scalar first",
    ),
}


@pytest.mark.slow
def test_every_mistake_is_named(
    shot: Shot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = write_folder(tmp_path, shot)
    names = [f"{i:03d}.png" for i in range(VIEWS)]
    for mistake, (spoil, message) in MISTAKES.items():
        write_poses(tmp_path / "poses.csv", names, spoil(shot.poses))
        code, said = run(capsys, arguments)
        assert code == 2, mistake
        assert message in said, mistake
    write_poses(tmp_path / "poses.csv", names, vectors(shot.poses))
    code, said = run(capsys, [*arguments, "--mounting", "eye-in-hand"])
    assert code == 2
    assert "choose eye-to-hand" in said
    code, said = run(capsys, [*arguments, "--columns", "8"])
    assert code == 2
    assert said.count("wrong board") == VIEWS
    (tmp_path / "lens.yaml").write_text("width: 640\nheight: 480\nfx: 600\nfy: 600\ncx: 3\ncy: 2\n")
    code, said = run(capsys, arguments)
    assert code == 2
    assert "1280 x 720 pixels, but the intrinsics are for 640 x 480" in said
    assert not (tmp_path / "calibration.yaml").exists()


@pytest.mark.slow
def test_duplicates_are_named_and_left_out(
    shot: Shot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures = [*shot.pictures, shot.pictures[2]]
    arguments = write_folder(
        tmp_path, shot, pictures=pictures, rows=vectors([*shot.poses, shot.poses[2]])
    )
    code, said = run(capsys, arguments)
    assert code == 0
    assert "010.png: duplicate of 002.png" in said
    assert load_calibration(tmp_path / "calibration.yaml").quality.views_taken == VIEWS


def test_board_is_written(tmp_path: Path) -> None:
    assert main(["board", str(tmp_path / "board.pdf"), "--columns", "7", "--rows", "5"]) == 0
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF-1.4")
    assert main(["board", str(tmp_path / "board.jpg")]) == 2


def test_help_is_light() -> None:
    code = "import sys, calibration.cli; print(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "cv2", "scipy", "torch"} & set(done.stdout.split())
