"""One self-contained page: what was found, how sure it is, and pictures to judge it by."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from calibration.depth import DepthSamples
from calibration.report_figures import coverage, depth_plot, error_map, residuals, view_bars
from calibration.report_style import STYLE
from calibration.solve import HandEye
from calibration.verify import HeldOut, Jackknife, predict
from calibration.views import Mounting, View
from tdpg_deploy.calibration_file import Calibration
from tdpg_deploy.cell_config import WorkspaceSection
from tdpg_deploy.geometry import Array

CROP_MARGIN = 40  # px of the picture around the board


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportInputs:
    """What the page shows. pictures: (H, W) grey by view name, for the overlay; may be empty."""

    calibration: Calibration
    found: HandEye
    views: Sequence[View]
    board_corners: Array
    rejected: Mapping[str, Sequence[str]]
    held_out: HeldOut | None
    jackknife: Jackknife | None
    depth_samples: Sequence[DepthSamples]
    pictures: Mapping[str, npt.NDArray[np.uint8]]
    workspace: WorkspaceSection


def write_html(inputs: ReportInputs) -> str:
    found, calibration = inputs.found, inputs.calibration
    camera = calibration.camera
    head = (
        "<h1>Hand-eye calibration</h1>"
        f"<p class=lead>{html.escape(calibration.mounting)} &middot; camera "
        f"{html.escape(camera.serial)} at {camera.width} &times; {camera.height} &middot; "
        f"{calibration.date:%Y-%m-%d}</p>"
    )
    body = "\n".join(
        [
            head,
            _cards(inputs),
            *_figures(inputs),
            "<h2>In numbers</h2>",
            _table(_rows(inputs)),
            *_notes(found),
        ]
    )
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>Hand-eye calibration</title><style>{STYLE}</style><main>{body}</main></html>\n"
    )


def _cards(inputs: ReportInputs) -> str:
    found, depth = inputs.found, inputs.calibration.depth
    position_sd, rotation_sd = found.standard_deviations
    used = sum(view.used for view in found.views)
    cards = [
        (f"{position_sd * 1e3:.3f} mm", "standard deviation of the camera's place"),
        (f"{np.rad2deg(rotation_sd):.4f}&deg;", "standard deviation of its attitude"),
    ]
    if found.mounting is Mounting.EYE_TO_HAND:
        mean = error_map(found, inputs.workspace)[1]
        cards.append((f"{mean * 1e3:.3f} mm", "deviation of a point seen in the workspace"))
    if inputs.held_out is not None:
        cards.append((f"{inputs.held_out.position * 1e3:.3f} mm", "on views held out"))
    if depth is not None:
        cards.append((f"{depth.left * 1e3:+.3f} mm", "of depth left after correction"))
    cards.append((f"{used} of {len(found.views) + len(inputs.rejected)}", "views used"))
    return (
        "<div class=cards>"
        + "".join(f"<div><b>{value}</b><span>{what}</span></div>" for value, what in cards)
        + "</div>"
    )


def _figures(inputs: ReportInputs) -> Iterator[str]:
    found = inputs.found
    yield "<div class=pair>"
    yield _figure(
        "Coverage",
        coverage(found, inputs.views),
        "Corners of all views in the picture; red ones were not used. Empty thirds weaken the "
        "result there.",
    )
    yield _figure(
        "Residuals",
        residuals(found, inputs.views, inputs.board_corners),
        "Predicted minus seen; the red circle is the pixel noise. A cloud off the middle, or of "
        "several lumps, means a model that does not fit.",
    )
    yield "</div><div class=pair>"
    if found.mounting is Mounting.EYE_TO_HAND:
        drawn, mean, worst = error_map(found, inputs.workspace)
        yield _figure(
            "Workspace",
            drawn,
            f"Standard deviation, in mm, of where a point on the table lands in base: mean "
            f"{mean * 1e3:.3f}, worst {worst * 1e3:.3f} mm. Errors of the arm at new places come "
            "on top.",
        )
    if (overlay := _overlay(inputs)) is not None:
        yield overlay
    yield "</div><div class=pair>"
    depth = inputs.calibration.depth
    if depth is not None:
        yield _figure(
            "Depth",
            depth_plot(inputs.depth_samples, depth.model()),
            f"On the board's white squares, against its calibrated plane: 1/z = {depth.a:.5f} / z "
            f"{depth.b:+.5f} per m; {depth.rms * 1e3:.2f} mm rms is left, {depth.fill:.0%} of the "
            "squares have depth.",
        )
    yield _figure(
        "Views", view_bars(found, inputs.rejected), "Reprojection error of each view, rms."
    )
    yield "</div>"


def _figure(title: str, content: str, caption: str) -> str:
    return (
        f"<figure><h2>{html.escape(title)}</h2>{content}"
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def _overlay(inputs: ReportInputs) -> str | None:
    worst = max(
        (view for view in inputs.found.views if view.used and view.name in inputs.pictures),
        key=lambda view: view.rms,
        default=None,
    )
    if worst is None:
        return None
    view = next(view for view in inputs.views if view.name == worst.name)
    scale = 2
    low = np.maximum(view.corners.min(axis=0).astype(int) - CROP_MARGIN, 0)
    high = view.corners.max(axis=0).astype(int) + CROP_MARGIN
    crop = inputs.pictures[view.name][low[1] : high[1], low[0] : high[0]]
    drawn = cv2.cvtColor(crop, cv2.COLOR_GRAY2BGR)
    drawn = cv2.resize(drawn, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)

    def at(pixels: Array) -> npt.NDArray[np.int64]:
        return np.asarray(np.round(16 * (scale * (pixels - low + 0.5) - 0.5)), np.int64)

    for u, v in at(view.corners):
        for dx, dy in ((112, 0), (0, 112)):  # 7 px each way, in sixteenths
            ends = ((int(u - dx), int(v - dy)), (int(u + dx), int(v + dy)))
            cv2.line(drawn, *ends, (40, 160, 20), 1, cv2.LINE_AA, shift=4)
    for u, v in at(predict(inputs.found, view, inputs.board_corners)):
        cv2.circle(drawn, (int(u), int(v)), 16 * 9, (40, 40, 220), 1, cv2.LINE_AA, shift=4)
    data = base64.b64encode(cv2.imencode(".png", drawn)[1].tobytes()).decode("ascii")
    name = html.escape(view.name)
    image = f'<img alt="overlay of {name}" src="data:image/png;base64,{data}">'
    return _figure(
        "Overlay",
        image,
        f"{view.name}, the worst view used ({worst.rms:.3f} px rms): green crosses are corners "
        "seen, red circles where they are predicted.",
    )


def _rows(inputs: ReportInputs) -> Iterator[tuple[str, str]]:
    found, calibration = inputs.found, inputs.calibration
    x, y, z = found.X_parent_camera.translation * 1e3
    angles = np.rad2deg(found.X_parent_camera.rotation.as_rotvec())
    sd = np.sqrt(np.diag(found.covariance))
    yield f"position, X_{found.mounting.camera_parent}_camera", f"{x:.3f}, {y:.3f}, {z:.3f} mm"
    yield "&plusmn; along x, y, z", ", ".join(f"{v * 1e3:.3f}" for v in sd[:3]) + " mm"
    yield "rotation vector", ", ".join(f"{v:.4f}" for v in angles) + "&deg;"
    yield "&plusmn; about x, y, z", ", ".join(f"{np.rad2deg(v):.4f}" for v in sd[3:]) + "&deg;"
    yield "reprojection, rms", f"{found.rms:.3f} px; pixel noise {found.pixel_noise:.3f} px"
    yield (
        "the arm's noise",
        f"{found.pose_noise.translation * 1e3:.3f} mm, "
        f"{np.rad2deg(found.pose_noise.rotation):.4f}&deg;",
    )
    yield "intrinsics", "refined: held-out views gain by it" if found.lens_refined else "as given"
    yield (
        "board",
        f"{found.board_scale:.5f} of its nominal size: held-out views gain by it"
        if found.scale_refined
        else "of the size given",
    )
    if (held := inputs.held_out) is not None:
        yield (
            "views held out",
            f"{held.rms_px:.3f} px; the board {held.position * 1e3:.3f} mm and "
            f"{np.rad2deg(held.angle):.4f}&deg; from where it is seen",
        )
    if (j := inputs.jackknife) is not None:
        yield (
            "jackknife",
            f"{j.position_sd * 1e3:.3f} mm, {np.rad2deg(j.rotation_sd):.4f}&deg;; leaving out a "
            f"fifth moves the camera by up to {j.largest_move * 1e3:.3f} mm",
        )
    if (depth := calibration.depth) is not None:
        yield (
            "depth",
            f"{depth.offset * 1e3:+.2f} mm before, {depth.left * 1e3:+.3f} mm after correction",
        )
    if (table := calibration.table) is not None:
        off = table.height - inputs.workspace.table_z
        yield (
            "the table",
            f"seen {off * 1e3:+.2f} mm from the cell file's, tilted by "
            f"{np.rad2deg(table.tilt):.3f}&deg;; {table.rms * 1e3:.2f} mm rms",
        )
    if found.mounting is Mounting.EYE_TO_HAND:
        yield "tags on the table", f"{len(calibration.tags)}, to notice a moved camera by"


def _table(rows: Iterator[tuple[str, str]]) -> str:
    cells = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in rows)
    return f"<table>{cells}</table>"


def _notes(found: HandEye) -> list[str]:
    if not found.notes:
        return []
    return [
        "<h2>Notes</h2><ul>",
        *(f"<li>{html.escape(note)}</li>" for note in found.notes),
        "</ul>",
    ]
