"""The board on paper and in pictures, against OpenCV's own drawing and exact projection."""

from __future__ import annotations

import re
import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from calibration.detect import charuco_board, detect, self_test
from calibration.drift import find_tags
from calibration.pictures import board_in_front, paint_board
from calibration.printing import (
    POINT,
    as_pdf,
    black_rectangles,
    lay_out,
    lay_out_tags,
    raster,
    write_board,
    write_sheet,
)
from calibration.synthetic import D435_720P
from calibration.target import CharucoTarget
from tdpg_deploy.errors import CalibrationError

TARGET = CharucoTarget()


@pytest.fixture(scope="module")
def picture() -> npt.NDArray[np.uint8]:
    grey = np.full((720, 1280, 3), 110, np.uint8)
    return paint_board(grey, TARGET, board_in_front(TARGET, 0.6), D435_720P)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(9, 6), (7, 5), (6, 4)])
def test_drawn_as_opencv_draws_it(columns: int, rows: int, legacy: bool) -> None:
    target = CharucoTarget(columns=columns, rows=rows, legacy=legacy)
    scale = 56  # px per square: a marker of 7 cells is 42 px
    drawn = raster(black_rectangles(target), target.size, scale / target.square)
    board = charuco_board(target)
    expected = board.generateImage((columns * scale, rows * scale), marginSize=0, borderBits=1)
    assert np.array_equal(drawn, expected)
    np.testing.assert_allclose(target.corners(), board.getChessboardCorners(), atol=1e-7)


def test_pdf_has_true_scale() -> None:
    pdf = as_pdf(lay_out(TARGET)).decode("latin-1")
    box = re.search(r"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert box is not None
    assert float(box[1]) * POINT == pytest.approx(0.297, abs=1e-6)
    first = re.search(r"^([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) re$", pdf, re.MULTILINE)
    assert first is not None
    assert float(first[3]) * POINT == pytest.approx(TARGET.square, abs=1e-7)
    assert int(pdf.split("startxref\n")[1].split()[0]) == pdf.index("xref\n0 ")


def test_png_carries_its_resolution(tmp_path: Path) -> None:
    write_board(TARGET, tmp_path / "board.png", dpi=300)
    data = (tmp_path / "board.png").read_bytes()
    at = data.index(b"pHYs")
    assert struct.unpack(">IIB", data[at + 4 : at + 13]) == (11811, 11811, 1)
    page = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    assert page is not None
    found = detect(np.asarray(page, np.uint8), TARGET)
    pixels_per_metre = np.diff(found.corners[:8, 0]).mean() / TARGET.square
    assert pixels_per_metre == pytest.approx(11811, rel=1e-3)


def test_printed_tags_are_found(tmp_path: Path) -> None:
    write_sheet(lay_out_tags(), tmp_path / "tags.png", dpi=150)
    page = cv2.imread(str(tmp_path / "tags.png"), cv2.IMREAD_GRAYSCALE)
    found = find_tags(np.asarray(page, np.uint8)).corners
    assert sorted(found) == [0, 1, 2, 3]
    sides = [np.linalg.norm(corners[1] - corners[0]) for corners in found.values()]
    assert sides == pytest.approx([0.05 * 150 / 0.0254] * 4, rel=5e-3)


def test_unknown_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"\.pdf or \.png"):
        write_board(TARGET, tmp_path / "board.svg")


def test_corners_are_where_geometry_puts_them(picture: npt.NDArray[np.uint8]) -> None:
    found = detect(picture, TARGET)
    X = board_in_front(TARGET, 0.6)
    exact, _ = cv2.projectPoints(
        TARGET.corners(),
        X.rotation.as_rotvec(),
        X.translation,
        D435_720P.as_matrix(),
        np.zeros(5),
    )
    error = found.corners - exact.reshape(-1, 2)[found.ids]
    assert len(found.ids) == 40
    assert not found.problems
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert error.std() < 0.05


def test_painting_respects_depth_and_distortion() -> None:
    lens = replace(D435_720P, distortion=(0.1, -0.05, 1e-3, 0.0, 0.0))
    X = board_in_front(TARGET, 0.6)
    depth = np.full((720, 1280), 2.0, np.float32)
    depth[:, :640] = 0.1  # something in front of the left half
    grey = np.full((720, 1280, 3), 110, np.uint8)
    painted = paint_board(grey, TARGET, X, lens, depth)
    assert (painted[:, :640] == 110).all()
    found = detect(painted, TARGET)
    exact, _ = cv2.projectPoints(
        TARGET.corners()[found.ids],
        X.rotation.as_rotvec(),
        X.translation,
        lens.as_matrix(),
        np.array(lens.distortion),
    )
    assert len(found.ids) > 8
    assert np.abs((found.corners - exact.reshape(-1, 2)).mean(axis=0)).max() < 0.03
    assert 0.5 < np.median(depth[(depth > 0.2) & (depth < 1.0)]) < 0.7


def test_self_test_passes_on_this_opencv() -> None:
    self_test()


def problem(picture: npt.NDArray[np.uint8], target: CharucoTarget = TARGET) -> str:
    problems = detect(picture, target).problems
    return problems[0] if problems else ""


def test_bad_pictures_are_named(picture: npt.NDArray[np.uint8]) -> None:
    blurred = np.asarray(cv2.GaussianBlur(picture, (0, 0), 4), np.uint8)
    moved = np.asarray(cv2.blur(picture, (15, 1)), np.uint8)
    assert problem(blurred).startswith("blurred")
    assert problem(moved).startswith("blurred")
    assert problem((picture * 0.2).astype(np.uint8)).startswith("dark")
    assert problem((picture * 0.03).astype(np.uint8)).startswith("dark")
    assert problem(np.ascontiguousarray(picture[:, :500])).startswith("partial")
    assert problem(np.full_like(picture, 128)).startswith("no board")


@pytest.mark.parametrize(
    "other",
    [
        CharucoTarget(columns=8),
        CharucoTarget(columns=11, rows=8),
        CharucoTarget(legacy=True),
        CharucoTarget(dictionary="DICT_4X4_100"),
        CharucoTarget(marker=0.017),
    ],
)
def test_wrong_boards_are_named(picture: npt.NDArray[np.uint8], other: CharucoTarget) -> None:
    assert problem(picture, other).startswith("wrong board")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"square": 28.0, "marker": 21.0}, "is that in mm"),
        ({"marker": 0.028}, "markers of"),
        ({"columns": 2}, "3 to 30"),
    ],
)
def test_impossible_boards_are_refused(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        CharucoTarget(**arguments)  # type: ignore[arg-type]


def test_too_small_a_dictionary_is_refused() -> None:
    with pytest.raises(CalibrationError, match="has 50 markers"):
        charuco_board(CharucoTarget(columns=12, rows=10, dictionary="DICT_4X4_50"))
