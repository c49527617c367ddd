"""One self-contained page: what was found, how sure it is, and pictures to judge it by."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from calibration.depth import DepthQuality
from calibration.solve import HandEye
from calibration.verify import HeldOut, Jackknife, predict, workspace_deviation
from calibration.views import Mounting, View
from tdpg_deploy.geometry import Array

WORKSPACE_X, WORKSPACE_Y = (0.25, 0.75), (-0.25, 0.25)  # m in base, mapped when none is given
RESIDUALS_SHOWN = 1.0  # px from the middle to the edge of the residuals' plot
STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;margin:.5rem 0}td,th{padding:.15rem .8rem;text-align:left;
border-bottom:1px solid #ddd}td+td{font-variant-numeric:tabular-nums}svg,img{max-width:100%;
height:auto;border:1px solid #ccc}figure{margin:1rem 0}figcaption{color:#555}.bad{color:#b00020}
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportInputs:
    """What the page shows. pictures: (H, W) grey by view name, for the overlay; may be empty.

    workspace: x and y ranges (m in base) and the table's z, for the error map.
    """

    found: HandEye
    views: Sequence[View]
    board_corners: Array
    rejected: Mapping[str, Sequence[str]]
    held_out: HeldOut | None = None
    jackknife: Jackknife | None = None
    depth: DepthQuality | None = None
    pictures: Mapping[str, npt.NDArray[np.uint8]] | None = None
    workspace: tuple[tuple[float, float], tuple[float, float], float] = (
        WORKSPACE_X,
        WORKSPACE_Y,
        0.0,
    )


def write_html(inputs: ReportInputs) -> str:
    found = inputs.found
    position_sd, rotation_sd = found.standard_deviations
    used = sum(view.used for view in found.views)
    parts = [
        "<h1>Hand-eye calibration</h1>",
        f"<p>{found.mounting.value}; {used} of {len(found.views) + len(inputs.rejected)} views "
        "used. "
        f"The camera's place is known to <b>{position_sd * 1e3:.3f} mm</b> and its attitude to "
        f"<b>{np.rad2deg(rotation_sd):.4f}&deg;</b> (one standard deviation, root of the summed "
        "variances).</p>",
        _table(_figures(inputs)),
        *_figure(
            "Coverage", _coverage(inputs), "Corners of all views in the picture; red: not used."
        ),
        *_figure(
            "Residuals",
            _residuals(inputs),
            f"Predicted minus seen, {RESIDUALS_SHOWN:g} px to the edge; the circle is the pixel "
            "noise. A cloud off the middle, or of several lumps, means a model that does not fit.",
        ),
    ]
    if inputs.pictures:
        parts += _figure(
            "Overlay",
            _overlay(inputs),
            "The worst view used: seen corners as green crosses, predicted ones as red circles.",
        )
    if found.mounting is Mounting.EYE_TO_HAND:
        parts += _figure(
            "Workspace",
            _error_map(inputs),
            "Standard deviation, in mm, of where a point that the camera sees lands in base. "
            "Errors of the arm at new places come on top.",
        )
    parts += ["<h2>Views</h2>", _view_table(inputs)]
    if found.notes:
        parts += [
            "<h2>Notes</h2><ul>",
            *(f"<li>{html.escape(n)}</li>" for n in found.notes),
            "</ul>",
        ]
    body = "\n".join(parts)
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Hand-eye calibration</title>'
        f"<style>{STYLE}</style>{body}</html>\n"
    )


def _figures(inputs: ReportInputs) -> list[tuple[str, str]]:
    found = inputs.found
    x, y, z = found.X_parent_camera.translation * 1e3
    rx, ry, rz = np.rad2deg(found.X_parent_camera.rotation.as_rotvec())
    sd = np.sqrt(np.diag(found.covariance))
    rows = [
        (
            f"X_{found.mounting.camera_parent}_camera",
            f"{x:.3f}, {y:.3f}, {z:.3f} mm; rotation vector {rx:.4f}, {ry:.4f}, {rz:.4f}&deg;",
        ),
        (
            "standard deviations",
            ", ".join(f"{value * 1e3:.3f}" for value in sd[:3])
            + " mm; "
            + ", ".join(f"{np.rad2deg(value):.4f}" for value in sd[3:])
            + "&deg;",
        ),
        ("reprojection, rms", f"{found.rms:.3f} px"),
        ("pixel noise", f"{found.pixel_noise:.3f} px"),
        (
            "arm's noise",
            f"{found.pose_noise.translation * 1e3:.3f} mm, "
            f"{np.rad2deg(found.pose_noise.rotation):.4f}&deg;",
        ),
        (
            "intrinsics",
            "refined: held-out views gain by it" if found.lens_refined else "as given",
        ),
        (
            "board",
            f"refined to {found.board_scale:.5f} of its nominal size: held-out views gain by it"
            if found.scale_refined
            else "as given",
        ),
    ]
    if inputs.held_out is not None:
        h = inputs.held_out
        rows.append(
            (
                "views held out",
                f"{h.rms_px:.3f} px; the board {h.position * 1e3:.3f} mm and "
                f"{np.rad2deg(h.angle):.4f}&deg; from where it is seen",
            )
        )
    if inputs.jackknife is not None:
        j = inputs.jackknife
        rows.append(
            (
                "jackknife",
                f"{j.position_sd * 1e3:.3f} mm, {np.rad2deg(j.rotation_sd):.4f}&deg;; leaving out "
                f"a fifth moves the camera by up to {j.largest_move * 1e3:.3f} mm",
            )
        )
    if inputs.depth is not None:
        d = inputs.depth
        rows.append(
            (
                "depth on white squares",
                f"{d.offset * 1e3:+.2f} mm before, {d.left * 1e3:+.3f} mm after correction; "
                f"{d.rms * 1e3:.2f} mm rms, {100 * d.fill:.0f} % filled",
            )
        )
    return rows


def _table(rows: Sequence[tuple[str, str]]) -> str:
    return "<table>" + "".join(f"<tr><td>{a}</td><td>{b}</td></tr>" for a, b in rows) + "</table>"


def _figure(title: str, picture: str, caption: str) -> list[str]:
    return [f"<h2>{title}</h2>", f"<figure>{picture}<figcaption>{caption}</figcaption></figure>"]


def _coverage(inputs: ReportInputs) -> str:
    lens, results = inputs.found.intrinsics, {v.name: v for v in inputs.found.views}
    marks = []
    for view in inputs.views:
        result = results.get(view.name)
        color = "#1f77b4" if result is not None and result.used else "#b00020"
        marks += [
            f'<circle cx="{u:.1f}" cy="{v:.1f}" r="4" fill="{color}" fill-opacity=".45"/>'
            for u, v in view.corners
        ]
    return _svg(lens.width, lens.height, "".join(marks), 640)


def _residuals(inputs: ReportInputs) -> str:
    half, marks = 200.0, []
    used = {view.name for view in inputs.found.views if view.used}
    for view in inputs.views:
        if view.name in used:
            residual = predict(inputs.found, view, inputs.board_corners) - view.corners
            for dx, dy in half * (1 + np.clip(residual / RESIDUALS_SHOWN, -1, 1)):
                marks.append(f'<circle cx="{dx:.1f}" cy="{dy:.1f}" r="1.6" fill-opacity=".4"/>')
    radius = half * inputs.found.pixel_noise / RESIDUALS_SHOWN
    axes = (
        f'<path d="M0 {half}H{2 * half}M{half} 0V{2 * half}" stroke="#ccc"/>'
        f'<circle cx="{half}" cy="{half}" r="{radius:.1f}" fill="none" stroke="#b00020"/>'
    )
    return _svg(2 * half, 2 * half, axes + "".join(marks), 400)


def _overlay(inputs: ReportInputs) -> str:
    pictures = inputs.pictures or {}
    worst = max(
        (view for view in inputs.found.views if view.used and view.name in pictures),
        key=lambda view: view.rms,
        default=None,
    )
    if worst is None:
        return "<p>No picture was kept.</p>"
    view = next(view for view in inputs.views if view.name == worst.name)
    drawn = cv2.cvtColor(pictures[view.name], cv2.COLOR_GRAY2BGR)
    for u, v in np.round(view.corners).astype(int):
        cv2.drawMarker(drawn, (int(u), int(v)), (0, 160, 0), cv2.MARKER_CROSS, 9, 1)
    for u, v in np.round(16 * predict(inputs.found, view, inputs.board_corners)).astype(int):
        cv2.circle(drawn, (int(u), int(v)), 16 * 7, (0, 0, 220), 1, cv2.LINE_AA, shift=4)
    data = base64.b64encode(cv2.imencode(".png", drawn)[1].tobytes()).decode("ascii")
    return (
        f'<img alt="overlay of {html.escape(view.name)}" src="data:image/png;base64,{data}">'
        f"<p>{html.escape(view.name)}: {worst.rms:.3f} px rms</p>"
    )


def _error_map(inputs: ReportInputs) -> str:
    (x0, x1), (y0, y1), z = inputs.workspace
    cells, size = 12, 36
    x, y = np.linspace(x0, x1, cells), np.linspace(y0, y1, cells)
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((cells, cells), z)], axis=-1)
    error = 1e3 * workspace_deviation(inputs.found.covariance, inputs.found.X_parent_camera, points)
    low, high = float(error.min()), float(error.max())
    marks = []
    for i in range(cells):  # x grows upwards, y to the left, as seen from the base
        for j in range(cells):
            share = (error[i, j] - low) / max(high - low, 1e-12)
            left, top = (cells - 1 - j) * size, (cells - 1 - i) * size
            marks.append(
                f'<rect x="{left}" y="{top}" width="{size}" height="{size}" '
                f'fill="hsl({210 - 190 * share:.0f},70%,75%)"/>'
                f'<text x="{left + size / 2}" y="{top + size / 2 + 4}" font-size="11" '
                f'text-anchor="middle">{error[i, j]:.3f}</text>'
            )
    caption = (
        f"<p>x {x0:.2f} to {x1:.2f} m upwards, y {y0:.2f} to {y1:.2f} m leftwards, z {z:.3f} m: "
        f"mean {error.mean():.3f} mm, worst {high:.3f} mm</p>"
    )
    return _svg(cells * size, cells * size, "".join(marks), cells * size) + caption


def _svg(width: float, height: float, content: str, shown: float) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        f'width="{shown:g}">{content}</svg>'
    )


def _view_table(inputs: ReportInputs) -> str:
    rows = ["<table><tr><th>view</th><th>rms px</th><th>chi&sup2; ratio</th><th></th></tr>"]
    for view in inputs.found.views:
        state = "" if view.used else '<span class="bad">does not fit the others</span>'
        rows.append(
            f"<tr><td>{html.escape(view.name)}</td><td>{view.rms:.3f}</td>"
            f"<td>{view.ratio:.2f}</td><td>{state}</td></tr>"
        )
    for name, problems in inputs.rejected.items():
        text = html.escape("; ".join(problems))
        rows.append(
            f'<tr><td>{html.escape(name)}</td><td></td><td></td><td class="bad">{text}</td></tr>'
        )
    return "".join([*rows, "</table>"])
