"""What an operator sees while views are collected: figures in the terminal, and a picture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from calibration.collection import Plan, Progress
from calibration.coverage import NAMES
from calibration.projection import project
from calibration.target import CharucoTarget
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Intrinsics

LEVEL = 8.0  # degrees; less of a turn or lean is not worth a word
BLUE, ORANGE, GREEN = (31, 119, 180), (255, 127, 14), (44, 160, 44)  # RGB


def panel(progress: Progress, plan: Plan) -> RenderableType:
    figures = Table.grid(padding=(0, 2))
    figures.add_row("views", f"{len(progress.views)}", "")
    known = np.isfinite(progress.deviation)
    figures.add_row(
        "predicted error",
        f"{progress.deviation * 1e3:.3f} mm" if known else "unknown",
        f"goal {plan.goal * 1e3:.3f} mm",
    )
    cover = progress.coverage
    for name, share, low, high in zip(NAMES, cover.share, cover.low, cover.high, strict=True):
        shown = f"{low:.2f} to {high:.2f}" if np.isfinite(low) else ""
        bar = ProgressBar(total=1.0, completed=float(share), width=24)
        figures.add_row(name, bar, shown)
    lines: list[RenderableType] = [figures]
    if progress.last is not None:
        style = "yellow" if progress.problems else "green"
        said = "; ".join(progress.problems) or "used"
        lines.append(Text(f"picture {progress.last.name}: {said}", style=style))
    elif progress.problems:
        lines.append(Text("; ".join(progress.problems), style="yellow"))
    if progress.X_camera_board is not None:
        lines.append(Text(f"next: {describe(progress.X_camera_board, plan.target)}"))
    return Panel(Group(*lines), title="collecting views", title_align="left", width=78)


def describe(X_camera_board: Transform, target: CharucoTarget) -> str:
    """Where the board should come to be, as a person would say it who looks at the picture."""
    middle = X_camera_board @ (np.array([*target.size, 0.0]) / 2)
    x, y, z = middle
    down = "upper" if y < -0.1 * z else "lower" if y > 0.1 * z else "middle"
    across = "left" if x < -0.1 * z else "right" if x > 0.1 * z else "middle"
    place = down if down == across else f"{down} {across}"
    turn = np.rad2deg(X_camera_board.rotation.as_euler("ZXY")[0])
    parts = [f"board in the {place}", f"{np.linalg.norm(middle):.2f} m away"]
    if abs(turn) >= LEVEL:
        parts.append(f"turned {abs(turn):.0f} degrees {'' if turn > 0 else 'counter-'}clockwise")
    normal = X_camera_board.rotation.as_matrix()[:, 2]  # into the board
    lean = float(np.rad2deg(np.arccos(np.clip(normal[2], -1, 1))))
    if lean >= LEVEL:
        sideways = abs(normal[0]) > abs(normal[1])
        edges = ("right", "left") if sideways else ("lower", "upper")
        edge = edges[0] if normal[0 if sideways else 1] > 0 else edges[1]
        parts.append(f"its {edge} side leaned {lean:.0f} degrees towards the camera")
    return ", ".join(parts)


def draw(progress: Progress, target: CharucoTarget, lens: Intrinsics) -> npt.NDArray[np.uint8]:
    """(H, W, 3) RGB: the last picture, all corners so far, and where the board is wanted next."""
    picture: npt.NDArray[np.uint8] = np.full((lens.height, lens.width, 3), 40, np.uint8)
    if progress.last is not None and progress.last.color.shape == picture.shape:
        picture = (progress.last.color * 0.6).astype(np.uint8)
    for view in progress.views:
        is_last = progress.last is not None and view.name == progress.last.name
        for u, v in np.round(16 * view.corners).astype(int):
            color = ORANGE if is_last else BLUE
            cv2.circle(picture, (int(u), int(v)), 16 * 4, color, -1, cv2.LINE_AA, shift=4)
    if progress.X_camera_board is not None:
        width, height = target.size
        outline = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0.0]])
        pixels = project(progress.X_camera_board @ outline, lens)[0]
        polygon = np.round(16 * pixels).astype(np.int32)[:, None]
        cv2.polylines(picture, [polygon], True, GREEN, 3, cv2.LINE_AA, shift=4)
        u, v = (int(value) for value in polygon[0, 0])
        cv2.circle(picture, (u, v), 16 * 9, GREEN, -1, cv2.LINE_AA, shift=4)
    return picture


def write_picture(picture: npt.NDArray[np.uint8], path: Path) -> None:
    """Whole or not at all, so that a viewer may reload it at any time. Raises CalibrationError."""
    partial = path.with_name(path.stem + ".partial.png")
    try:
        partial.write_bytes(cv2.imencode(".png", picture[..., ::-1])[1].tobytes())
        partial.replace(path)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written ({error.strerror})") from error
