"""The pictures of the report, as SVG: where the views looked, and what they leave unexplained."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import numpy as np

from calibration.depth import DepthSamples
from calibration.solve import HandEye
from calibration.verify import predict, workspace_deviation
from calibration.views import View
from tdpg_deploy.cell_config import WorkspaceSection
from tdpg_deploy.depth_model import DepthModel
from tdpg_deploy.geometry import Array

GOOD, BAD, MUTED, GRID = "#1f6feb", "#c62828", "#57606a", "#d0d7de"
RESIDUAL_STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # px from the middle to the edge
CELLS = 8


def svg(width: float, height: float, content: str, label: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img" '
        f'aria-label="{html.escape(label)}">{content}</svg>'
    )


def text(x: float, y: float, said: str, *, size: float = 12, anchor: str = "middle") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="{anchor}" '
        f'fill="{MUTED}">{html.escape(said)}</text>'
    )


def line(x0: float, y0: float, x1: float, y1: float, color: str = GRID, width: float = 1) -> str:
    return (
        f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{color}" '
        f'stroke-width="{width:g}"/>'
    )


def coverage(found: HandEye, views: Sequence[View]) -> str:
    """All corners in the picture."""
    lens, used = found.intrinsics, _used(found)
    w, h = lens.width, lens.height
    marks = [f'<rect width="{w}" height="{h}" fill="none" stroke="{GRID}" stroke-width="4"/>']
    for third in (1 / 3, 2 / 3):
        marks.append(line(w * third, 0, w * third, h, width=2))
        marks.append(line(0, h * third, w, h * third, width=2))
    for view in views:
        color = GOOD if view.name in used else BAD
        marks += [
            f'<circle cx="{u:.0f}" cy="{v:.0f}" r="7" fill="{color}" fill-opacity=".4"/>'
            for u, v in view.corners
        ]
    return svg(w, h, "".join(marks), "corners of all views in the picture")


def residuals(found: HandEye, views: Sequence[View], board_corners: Array) -> str:
    """Predicted minus seen of every corner used."""
    used = _used(found)
    left = np.concatenate(
        [predict(found, v, board_corners) - v.corners for v in views if v.name in used]
    )
    largest = float(np.percentile(np.abs(left), 99))
    shown = next((step for step in RESIDUAL_STEPS if step >= largest), RESIDUAL_STEPS[-1])
    half = 240.0
    marks = [line(0, half, 2 * half, half), line(half, 0, half, 2 * half)]
    for share in (0.5, 1.0):
        marks.append(
            f'<circle cx="{half}" cy="{half}" r="{share * half - 1:.1f}" fill="none" '
            f'stroke="{GRID}"/>'
        )
        marks.append(text(half + share * half - 6, half - 6, f"{share * shown:g} px", anchor="end"))
    marks += [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2" fill="{GOOD}" fill-opacity=".4"/>'
        for x, y in half * (1 + np.clip(left / shown, -1, 1))
    ]
    radius = half * min(found.pixel_noise / shown, 1.0)
    marks.append(
        f'<circle cx="{half}" cy="{half}" r="{radius:.1f}" fill="none" stroke="{BAD}" '
        'stroke-width="2"/>'
    )
    return svg(2 * half, 2 * half, "".join(marks), "residuals of the corners used")


def view_bars(found: HandEye, rejected: Mapping[str, Sequence[str]]) -> str:
    """Each view's rms; those that do not fit in red, at the length that fits."""
    row, left, width = 18.0, 110.0, 640.0
    longest = max([v.rms for v in found.views if v.used], default=1.0) * 1.15
    marks = []
    for i, view in enumerate(found.views):
        y = i * row
        length = min(view.rms / longest, 1.0) * (width - left - 190)
        said = f"{view.rms:.3f} px" + ("" if view.used else ", does not fit the others")
        marks += [
            text(left - 8, y + 13, view.name, anchor="end"),
            f'<rect x="{left}" y="{y + 4:.1f}" width="{length:.1f}" height="{row - 7}" rx="2" '
            f'fill="{GOOD if view.used else BAD}" fill-opacity=".75"/>',
            text(left + length + 6, y + 13, said, anchor="start"),
        ]
    for i, (name, problems) in enumerate(rejected.items(), start=len(found.views)):
        marks.append(text(left - 8, i * row + 13, name, anchor="end"))
        marks.append(text(left, i * row + 13, "; ".join(problems), anchor="start"))
    height = row * (len(found.views) + len(rejected)) + 4
    return svg(width, height, "".join(marks), "reprojection error of each view")


def error_map(found: HandEye, workspace: WorkspaceSection) -> tuple[str, float, float]:
    """The workspace from above, base below; mean and worst deviation in metres."""
    x, y = np.linspace(*workspace.x_range, CELLS), np.linspace(*workspace.y_range, CELLS)
    points = np.stack(
        [*np.meshgrid(x, y, indexing="ij"), np.full((CELLS, CELLS), workspace.table_z)], axis=-1
    )
    error = workspace_deviation(found.covariance, found.X_parent_camera, points)
    low, high = float(error.min()), float(error.max())
    size, left, top = 56.0, 58.0, 12.0
    marks = []
    for i in range(CELLS):  # x grows upwards, y to the left, as seen from the base
        for j in range(CELLS):
            share = (error[i, j] - low) / max(high - low, 1e-12)
            a, b = left + (CELLS - 1 - j) * size, top + (CELLS - 1 - i) * size
            marks.append(
                f'<rect x="{a}" y="{b}" width="{size}" height="{size}" fill="#1f6feb" '
                f'fill-opacity="{0.08 + 0.62 * share:.2f}" stroke="#fff"/>'
                f'<text x="{a + size / 2}" y="{b + size / 2 + 4}" font-size="13" '
                f'text-anchor="middle" fill="#1f2328">{error[i, j] * 1e3:.3f}</text>'
            )
    side, bottom = CELLS * size, top + CELLS * size
    (x0, x1), (y0, y1) = workspace.x_range, workspace.y_range
    marks.append(text(left - 8, bottom - 4, f"x {x0:.2f}", anchor="end"))
    marks.append(text(left - 8, top + 12, f"x {x1:.2f}", anchor="end"))
    marks.append(text(left, bottom + 18, f"y {y1:+.2f} m", anchor="start"))
    marks.append(text(left + side, bottom + 18, f"y {y0:+.2f} m", anchor="end"))
    marks.append(text(left + side / 2, bottom + 18, "the robot's base is on this side"))
    drawn = svg(left + side + 12, bottom + 26, "".join(marks), "error over the workspace, mm")
    return drawn, float(error.mean()), high


def depth_plot(samples: Sequence[DepthSamples], model: DepthModel) -> str:
    """Measured minus expected depth over distance, before and after the correction."""
    expected = np.concatenate([s.expected for s in samples])
    measured = np.concatenate([s.measured for s in samples]).astype(np.float32)
    known = np.isfinite(measured)
    expected, measured = expected[known], measured[known]
    before = 1e3 * (measured - expected)
    after = 1e3 * (model.correct(measured) - expected)
    width, height, left, bottom = 640.0, 300.0, 52.0, 34.0
    near, far = float(expected.min()), float(expected.max())
    usual = np.percentile(np.abs(np.concatenate([before, after])), 90)  # an arm may hide squares
    reach = max(1.0, 2 * float(usual))

    def place(z: float, error: float) -> tuple[float, float]:
        across = left + (z - near) / max(far - near, 1e-6) * (width - left - 12)
        return across, (height - bottom) * (1 - (np.clip(error / reach, -1, 1) + 1) / 2)

    marks = []
    for level in (-reach, -reach / 2, 0.0, reach / 2, reach):
        y = place(near, level)[1]
        marks.append(line(left, y, width - 12, y, MUTED if level == 0 else GRID))
        marks.append(
            text(left - 6, min(max(y + 4, 10), height - bottom), f"{level:+.1f}", anchor="end")
        )
    for z in np.linspace(near, far, 5):
        anchor = "end" if z == far else "start" if z == near else "middle"
        marks.append(text(place(z, 0)[0], height - bottom + 16, f"{z:.2f} m", anchor=anchor))
    for errors, color in ((before, BAD), (after, GOOD)):
        for z, error in zip(expected, errors, strict=True):
            a, b = place(float(z), float(error))
            marks.append(
                f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2" fill="{color}" fill-opacity=".4"/>'
            )
    marks.append(
        text(left + 8, 16, "mm of depth: red before, blue after correction", anchor="start")
    )
    return svg(width, height, "".join(marks), "error of depth over distance")


def _used(found: HandEye) -> set[str]:
    return {view.name for view in found.views if view.used}
