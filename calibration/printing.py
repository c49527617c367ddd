"""The board on paper at its true size: vector PDF, or PNG with its resolution written inside.

Both carry a line to be measured after printing: printers scale, and a board 0.5 % too large
moves the camera by millimetres unless that is known.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from calibration.target import CharucoTarget
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array
from tdpg_deploy.markers import TABLE_TAGS, TAG_COUNT, TAG_SIDE, marker_rectangles, table_tags

MARGIN = 0.018  # m around the board; the ruler lies in the lower one
RULER = 0.100  # m
POINT = 0.0254 / 72  # m
PAPER = {"A4": (0.297, 0.210), "A3": (0.420, 0.297), "A2": (0.594, 0.420), "A1": (0.841, 0.594)}
SUFFIXES = (".pdf", ".png")


@dataclass(frozen=True, kw_only=True, eq=False)
class Sheet:
    """One page. black: (n, 4) rectangles x0, y0, x1, y1; metres from the upper left, y down."""

    size: tuple[float, float]
    black: Array
    text_at: tuple[float, float]
    text: str


def write_board(target: CharucoTarget, path: Path, *, dpi: int = 600) -> None:
    """A PDF or a PNG, by the suffix. Raises CalibrationError."""
    write_sheet(lay_out(target), path, dpi=dpi)


def write_sheet(sheet: Sheet, path: Path, *, dpi: int = 600) -> None:
    """A PDF or a PNG, by the suffix. Raises CalibrationError."""
    if path.suffix.lower() not in SUFFIXES:
        raise CalibrationError(f"{path}: write it to a file ending in .pdf or .png")
    data = as_pdf(sheet) if path.suffix.lower() == ".pdf" else as_png(sheet, dpi)
    try:
        path.write_bytes(data)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written ({error.strerror})") from error


def lay_out_tags() -> Sheet:
    """AprilTags for the table, to be cut apart and glued around the workspace."""
    size = PAPER["A4"]
    step = TAG_SIDE + 0.015  # white around each tag, and room for scissors
    return Sheet(
        size=size,
        black=np.concatenate(
            [
                marker_rectangles(table_tags(), number, TAG_SIDE, [MARGIN + number * step, MARGIN])
                for number in range(TAG_COUNT)
            ]
        ),
        text_at=(MARGIN, size[1] - 0.008),
        text=f"{TABLE_TAGS}, {TAG_COUNT} tags of {TAG_SIDE * 1e3:g} mm: leave 6 mm of white "
        "around each, glue them flat around the workspace, in the camera's sight.",
    )


def lay_out(target: CharucoTarget) -> Sheet:
    """The board in the middle of the smallest paper that holds it, or of its own size."""
    width, height = target.size
    least = (width + 2 * MARGIN, height + 2 * MARGIN)
    fitting = [size for size in PAPER.values() if least[0] <= size[0] and least[1] <= size[1]]
    page = fitting[0] if fitting else (max(least[0], RULER + 2 * MARGIN), least[1])
    corner = np.array([(page[0] - width) / 2, (page[1] - height) / 2])
    y = page[1] - 0.012  # the text below stays clear of the 5 mm that printers leave white
    ruler = [[corner[0], y, corner[0] + RULER, y + 0.0003]]
    ruler += [
        [corner[0] + x - 0.00015, y - 0.003, corner[0] + x + 0.00015, y]
        for x in np.linspace(0, RULER, 11)
    ]
    return Sheet(
        size=page,
        black=np.concatenate([black_rectangles(target) + np.tile(corner, 2), ruler]),
        text_at=(corner[0], y + 0.005),
        text=(
            f"{target.columns} x {target.rows} squares of {target.square * 1e3:g} mm, markers "
            f"{target.marker * 1e3:g} mm, {target.dictionary}"
            f"{', legacy' if target.legacy else ''}. Print at 100 %: the line is "
            f"{RULER * 1e3:g} mm. Else give the length of a measured square."
        ),
    )


def black_rectangles(target: CharucoTarget) -> Array:
    """(n, 4) x0, y0, x1, y1 in metres in the board's frame: black squares, markers' dark cells."""
    s = target.square
    rows, columns = np.mgrid[0 : target.rows, 0 : target.columns]
    squares = np.stack([columns.ravel(), rows.ravel()], axis=1)
    white = {tuple(square) for square in np.round(target.white_squares() / s - 0.5).astype(int)}
    black = [[x * s, y * s, (x + 1) * s, (y + 1) * s] for x, y in squares if (x, y) not in white]
    markers = [
        marker_rectangles(dictionary(target), marker_id, target.marker, middle - target.marker / 2)
        for marker_id, middle in enumerate(target.white_squares())
    ]
    return np.concatenate([np.array(black, np.float64), *markers])


def dictionary(target: CharucoTarget) -> cv2.aruco.Dictionary:
    """Raises CalibrationError."""
    number = getattr(cv2.aruco, target.dictionary, None)
    if number is None or not target.dictionary.startswith("DICT_"):
        raise CalibrationError(
            f"{target.dictionary} is no ArUco dictionary; DICT_5X5_100 and DICT_4X4_50 are"
        )
    found = cv2.aruco.getPredefinedDictionary(number)
    needed = len(target.white_squares())
    if len(found.bytesList) < needed:
        raise CalibrationError(
            f"{target.dictionary} has {len(found.bytesList)} markers, the board needs {needed}: "
            "choose a larger dictionary or a smaller board"
        )
    return found


def raster(rectangles: Array, size: tuple[float, float], scale: float) -> npt.NDArray[np.uint8]:
    """Grey picture (H, W), white with black rectangles; `scale` pixels per metre."""
    width, height = (round(side * scale) for side in size)
    picture = np.full((height, width), 255, np.uint8)
    for x0, y0, x1, y1 in np.round(rectangles * scale).astype(int):
        picture[y0 : max(y1, y0 + 1), x0 : max(x1, x0 + 1)] = 0
    return picture


def as_png(sheet: Sheet, dpi: int) -> bytes:
    scale = dpi / 0.0254
    picture = raster(sheet.black, sheet.size, scale)
    x, y = (round(value * scale) for value in sheet.text_at)
    height = 0.0018 * scale / 21  # of Hershey Simplex, whose capitals are 21 px high
    cv2.putText(picture, sheet.text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, height, 0, round(dpi / 150))
    data = bytes(cv2.imencode(".png", picture)[1])
    per_metre = round(scale)
    # PNG specification 11.3.5.3: pHYs, pixels per unit in x and y, unit 1 is the metre.
    body = b"pHYs" + struct.pack(">IIB", per_metre, per_metre, 1)
    chunk = struct.pack(">I", 9) + body + struct.pack(">I", zlib.crc32(body))
    after_header = 8 + 25
    return data[:after_header] + chunk + data[after_header:]


def as_pdf(sheet: Sheet) -> bytes:
    """PDF 1.4 with one page (ISO 32000-1): rectangles and one line of text."""
    width, height = (side / POINT for side in sheet.size)
    drawing = [
        f"{x0 / POINT:.4f} {height - y1 / POINT:.4f} "
        f"{(x1 - x0) / POINT:.4f} {(y1 - y0) / POINT:.4f} re"
        for x0, y0, x1, y1 in sheet.black
    ]
    x, y = sheet.text_at[0] / POINT, height - sheet.text_at[1] / POINT
    text = f"BT /F1 6 Tf {x:.2f} {y:.2f} Td ({sheet.text}) Tj ET"
    content = "\n".join([*drawing, "f", text]).encode("ascii")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] "
        "/Resources << /Font << /F1 5 0 R >> >> /Contents 4 0 R >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%b\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    data, offsets = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, start=1):
        offsets.append(len(data))
        data += b"%d 0 obj\n%b\nendobj\n" % (number, body)
    count, table = len(objects) + 1, b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    return b"%bxref\n0 %d\n0000000000 65535 f \n%btrailer\n" % (data, count, table) + (
        b"<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (count, len(data))
    )
