"""Pictures in a folder to calibration and report, through the command line; and what it loads."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.cli import main
from calibration.pictures import paint_board
from calibration.synthetic import Truth, make_truth, observe
from calibration.target import DEFAULT_TARGET
from calibration.views import Mounting, PoseNoise
from tdpg_deploy.calibration_file import load_calibration


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    """Twelve noisy pictures, one of them blurred, with poses and lens."""
    path = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(4)
    truth = make_truth(Mounting.EYE_TO_HAND, DEFAULT_TARGET.corners(), rng)
    still = PoseNoise(translation=0.0, rotation=0.0)
    rows = []
    for view in observe(truth, 12, rng, pose_noise=still):
        X_camera_board = truth.X_parent_camera.inverse() @ view.X_base_tool @ truth.X_parent_board
        grey = np.full((720, 1280, 3), 110, np.uint8)
        picture = paint_board(grey, DEFAULT_TARGET, X_camera_board, truth.intrinsics)
        picture = (picture + rng.normal(0, 3, picture.shape)).clip(0, 255).astype(np.uint8)
        if view.name == "003":
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), 4), np.uint8)
        cv2.imwrite(str(path / f"{view.name}.png"), picture)
        rows.append([f"{view.name}.png", *view.X_base_tool.as_rotation_vector()])
    with (path / "poses.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["image", "x", "y", "z", "rx", "ry", "rz"], *rows])
    k = truth.intrinsics
    (path / "lens.yaml").write_text(
        f"width: 1280\nheight: 720\nfx: {k.fx}\nfy: {k.fy}\ncx: {k.cx}\ncy: {k.cy}\n"
    )
    return path, truth


@pytest.mark.slow
def test_pictures_become_a_calibration_and_a_page(
    folder: tuple[Path, Truth], capsys: pytest.CaptureFixture[str]
) -> None:
    path, truth = folder
    files = ["--images", str(path), "--poses", str(path / "poses.csv")]
    files += ["--lens", str(path / "lens.yaml"), "--serial", "8323"]
    out, page = path / "calibration.yaml", path / "calibration.html"
    assert main(["solve", *files, "--out", str(out), "--report", str(page)]) == 0
    assert "003.png: blurred" in capsys.readouterr().out
    calibration = load_calibration(out)
    error = truth.X_parent_camera.distance(calibration.pose.transform())[0]
    assert error < 0.2e-3
    assert error < 4 * calibration.quality.position_sd
    html = page.read_text()
    assert html.count("<svg") == 4  # coverage, residuals, workspace, views
    assert "data:image/png;base64," in html
    assert 'src="http' not in html
    assert main(["verify", str(out), "--serial", "other"]) == 1
    # The other mounting is not accepted silently.
    capsys.readouterr()
    assert main(["solve", *files, "--mounting", "eye-in-hand", "--out", str(out)]) == 2
    assert "choose eye-to-hand" in capsys.readouterr().out.replace("\n", " ")


def test_board_is_written(tmp_path: Path) -> None:
    assert main(["board", str(tmp_path / "board.pdf"), "--columns", "7", "--rows", "5"]) == 0
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF-1.4")
    assert main(["board", str(tmp_path / "board.jpg")]) == 2


def loaded(statement: str) -> set[str]:
    code = f"{statement}\nimport sys; print(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_help_is_light() -> None:
    assert not {"numpy", "cv2", "scipy", "torch"} & loaded("import calibration.cli")
