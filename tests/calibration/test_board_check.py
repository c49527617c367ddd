"""A printed board's faults, put in by OpenCV's projection of bent and stretched corners."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.board_check import BoardCheck, check_board
from calibration.cli import main
from calibration.detect import Detection
from calibration.pictures import board_in_front, paint_board
from calibration.synthetic import D435_720P
from calibration.target import DEFAULT_TARGET
from tdpg_deploy.errors import CalibrationError

CORNERS = DEFAULT_TARGET.corners()
NOISE = 0.05  # px


def photo(*, sag: float = 0.0, stretch: float = 0.0, seed: int = 0) -> Detection:
    """sag: m in the middle of a board bent about a column. stretch: of rows."""
    middle = CORNERS.mean(axis=0)
    printed = (CORNERS - middle) * [1 + stretch, 1, 1]
    half = np.ptp(CORNERS[:, 0]) / 2
    printed[:, 2] = sag * (printed[:, 0] / half) ** 2
    X = board_in_front(DEFAULT_TARGET, 0.4)
    pixels, _ = cv2.projectPoints(
        printed + middle, X.rotation.as_rotvec(), X.translation, D435_720P.as_matrix(), np.zeros(5)
    )
    noise = np.random.default_rng(seed).normal(0, NOISE, (len(CORNERS), 2))
    return Detection(
        ids=np.arange(len(CORNERS)), corners=pixels.reshape(-1, 2) + noise, problems=()
    )


def check(found: Detection, measured: float | None = None) -> BoardCheck:
    return check_board(found, DEFAULT_TARGET, D435_720P, measured)


def test_a_good_board_passes() -> None:
    for seed in range(20):
        found = check(photo(seed=seed), measured=0.2523)
        assert not found.problems(DEFAULT_TARGET)
        assert found.rms == pytest.approx(NOISE, rel=0.4)


def test_a_bent_board_is_measured() -> None:
    found = check(photo(sag=2e-3))
    assert found.sag == pytest.approx(2e-3, abs=4 * found.sag_sd)
    assert found.problems(DEFAULT_TARGET)[0].startswith("bent by")


def test_a_stretched_print_is_measured() -> None:
    found = check(photo(stretch=0.01))
    assert found.stretch == pytest.approx(0.01, abs=4 * found.stretch_sd)
    assert "as long as columns" in found.problems(DEFAULT_TARGET)[0]


def test_a_scaled_print_needs_a_ruler() -> None:
    assert check(photo()).scale is None
    (problem,) = check(photo(), measured=0.97 * DEFAULT_TARGET.size[0]).problems(DEFAULT_TARGET)
    assert "0.9700 of its nominal size" in problem
    assert "--square 0.027160" in problem


def test_a_board_half_seen_does_not_do() -> None:
    whole = photo()
    half = Detection(ids=whole.ids[:20], corners=whole.corners[:20], problems=())
    with pytest.raises(CalibrationError, match="20 of 40 corners are seen"):
        check(half)


def test_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grey = np.full((720, 1280, 3), 110, np.uint8)
    picture = paint_board(grey, DEFAULT_TARGET, board_in_front(DEFAULT_TARGET, 0.4), D435_720P)
    cv2.imwrite(str(tmp_path / "photo.png"), picture)
    k = D435_720P
    (tmp_path / "lens.yaml").write_text(
        f"width: 1280\nheight: 720\nfx: {k.fx}\nfy: {k.fy}\ncx: {k.cx}\ncy: {k.cy}\n"
    )
    command = ["check-board", str(tmp_path / "photo.png"), "--lens", str(tmp_path / "lens.yaml")]
    assert main(command) == 0
    assert "measure a row of squares" in capsys.readouterr().out
    assert main([*command, "--measured", "0.2550"]) == 1
    assert "1.0119 of its nominal size" in capsys.readouterr().out
