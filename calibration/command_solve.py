"""tdpg-calibrate solve: from a record, or from pictures and poses in files."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from calibration.board_arguments import target_of
from calibration.collection import view_of
from calibration.depth import DepthQuality, DepthSamples, fit_depth, sample_depth
from calibration.detect import self_test
from calibration.drift import LEAST_TAGS, find_tags
from calibration.file import make_calibration
from calibration.folder import read_lens, read_picture, read_views
from calibration.record import Record, RecordedView, read_record, record_hash
from calibration.report import ReportInputs, write_html
from calibration.solve import HandEye, solve
from calibration.table import TablePlane, fit_table, workspace_points
from calibration.target import CharucoTarget
from calibration.verify import hold_out, predicted_board
from calibration.views import Mounting, View
from tdpg_deploy.calibration_file import save_calibration
from tdpg_deploy.cell_config import WorkspaceSection
from tdpg_deploy.depth_model import DepthModel
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.hal import Intrinsics

T = TypeVar("T")
UNKNOWN = "unknown"  # serial number
TABLE_OFF, TABLE_TILTED = 3e-3, np.deg2rad(0.5)  # beyond, the cell file and the camera disagree


@dataclass(frozen=True, kw_only=True, eq=False)
class Taken:
    """What there is to solve from.

    date: when it was taken, as far as that is known. pictures (grey), depths (m): by view name.
    table: the look at the table without the board; table_picture: of it, or alone, from a file.
    """

    date: datetime
    mounting: Mounting
    target: CharucoTarget
    workspace: WorkspaceSection
    views: Sequence[View]
    rejected: dict[str, tuple[str, ...]]
    lens: Intrinsics
    serial: str
    pictures: dict[str, npt.NDArray[np.uint8]]
    depths: dict[str, npt.NDArray[np.float32]]
    table: RecordedView | None = None
    table_picture: npt.NDArray[np.uint8] | None = None


def run_solve(args: argparse.Namespace, console: Console) -> int:
    self_test()
    taken = from_record(args) if args.record else from_folder(args)
    for name, problems in taken.rejected.items():
        console.print(f"{name}: {'; '.join(problems)}", style="yellow", markup=False)
    if not taken.views:
        raise CalibrationError(
            f"the board is in none of the {len(taken.rejected)} pictures; see the reasons above"
        )
    corners = taken.target.corners()
    found = solve(taken.views, corners, taken.lens, taken.mounting)

    def tried(check: Callable[[], T]) -> T | None:
        try:
            return check()
        except CalibrationError as error:  # the pose still stands
            console.print(str(error), style="yellow", markup=False)
            return None

    checks = tried(lambda: hold_out(found, taken.views, corners, taken.lens))
    held_out, jackknife = checks or (None, None)
    samples = depth_samples(taken, found) if taken.depths else []
    depth = tried(lambda: fit_depth(samples)) if samples else None
    table = None if taken.table is None else tried(lambda: see_table(taken, found, depth))
    tags = {} if taken.table_picture is None else find_tags(taken.table_picture).corners
    calibration = make_calibration(
        found,
        taken.target,
        serial=taken.serial,
        date=taken.date,
        arm_serial=args.arm_serial,
        depth=depth,
        table=table,
        tags=tags if len(tags) >= LEAST_TAGS else {},
        record_sha256=record_hash(args.record) if args.record else None,
    )
    save_calibration(calibration, args.out)
    page = write_html(
        ReportInputs(
            calibration=calibration,
            found=found,
            views=taken.views,
            board_corners=corners,
            rejected=taken.rejected,
            held_out=held_out,
            jackknife=jackknife,
            depth_samples=samples,
            pictures=taken.pictures,
            workspace=taken.workspace,
        )
    )
    try:
        args.report.write_text(page, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{args.report}: cannot be written ({error.strerror})") from error
    console.print(summary(found))
    if table is not None and (problem := table_problem(table, taken.workspace)):
        console.print(problem, style="yellow", markup=False)
    if taken.mounting is Mounting.EYE_TO_HAND and not calibration.tags:
        console.print(
            f"{len(tags)} table tags were seen, {LEAST_TAGS} are needed: "
            "tdpg-run will not notice a moved camera",
            style="yellow",
        )
    if taken.mounting is Mounting.EYE_TO_HAND and taken.serial == UNKNOWN:
        console.print(
            "the camera's serial number is not known, so tdpg-run will refuse this calibration: "
            "give --serial",
            style="yellow",
        )
    console.print(f"{args.out}, {args.report}", soft_wrap=True)
    return 0


def from_folder(args: argparse.Namespace) -> Taken:
    missing = [name for name in ("images", "poses", "lens") if getattr(args, name) is None]
    if missing:
        raise CalibrationError(f"give --{missing[0]} as well, or --record alone")
    lens, target = read_lens(args.lens), target_of(args)
    views, rejected = read_views(args.images, args.poses, target, lens)
    return Taken(
        date=datetime.now(timezone.utc),
        mounting=Mounting(args.mounting),
        target=target,
        workspace=WorkspaceSection(),
        views=views,
        rejected={picture.name: picture.problems for picture in rejected},
        lens=lens,
        serial=args.serial or UNKNOWN,
        pictures={view.name: read_picture(args.images / view.name, lens) for view in views},
        depths={},
        table_picture=None if args.table is None else read_picture(args.table, lens),
    )


def from_record(args: argparse.Namespace) -> Taken:
    record = read_record(args.record)
    if not record.views:
        raise CalibrationError(f"{args.record}: holds no whole view; collect again")
    views, rejected = [], {}
    for recorded in record.views:
        view, problems = view_of(recorded, record.setup.target)
        if view is None:
            rejected[recorded.name] = problems
        else:
            views.append(view)
    return Taken(
        date=record.date,
        mounting=record.setup.mounting,
        target=record.setup.target,
        workspace=record.setup.workspace,
        views=views,
        rejected=rejected,
        lens=record.views[0].intrinsics,
        serial=record.views[0].serial,
        pictures={r.name: r.color.mean(axis=2).astype(np.uint8) for r in record.views},
        depths={r.name: r.depth for r in record.views},
        table=record.table,
        table_picture=_table_picture(args, record),
    )


def _table_picture(args: argparse.Namespace, record: Record) -> npt.NDArray[np.uint8] | None:
    if args.table is not None:
        return read_picture(args.table, record.views[0].intrinsics)
    return None if record.table is None else record.table.color


def depth_samples(taken: Taken, found: HandEye) -> list[DepthSamples]:
    used = {view.name for view in found.views if view.used}
    return [
        sample_depth(
            taken.depths[view.name],
            taken.target,
            predicted_board(found, view),
            found.intrinsics,
            found.board_scale,
        )
        for view in taken.views
        if view.name in used
    ]


def see_table(
    taken: Taken, found: HandEye, depth: tuple[DepthModel, DepthQuality] | None
) -> TablePlane:
    """Raises CalibrationError when too little of it is seen."""
    assert taken.table is not None
    seen = taken.table.depth if depth is None else depth[0].correct(taken.table.depth)
    points = workspace_points(seen, found.intrinsics, found.X_base_camera, taken.workspace)
    return fit_table(points, taken.workspace)


def table_problem(table: TablePlane, workspace: WorkspaceSection) -> str | None:
    """What is to be mended when the table is not where the cell file has it."""
    off = table.height - workspace.table_z
    if abs(off) <= TABLE_OFF and table.tilt <= TABLE_TILTED:
        return None
    return (
        f"the table is seen {off * 1e3:+.1f} mm from workspace.table_z = {workspace.table_z} m, "
        f"tilted by {np.rad2deg(table.tilt):.2f} degrees: correct table_z, or level the table"
    )


def summary(found: HandEye) -> Table:
    position_sd, rotation_sd = found.standard_deviations
    x, y, z = found.X_parent_camera.translation * 1e3
    table = Table("what", "value", title=found.mounting.value)
    table.add_row(f"X_{found.mounting.camera_parent}_camera", f"{x:.2f}, {y:.2f}, {z:.2f} mm")
    table.add_row(
        "standard deviation", f"{position_sd * 1e3:.3f} mm, {np.rad2deg(rotation_sd):.4f} deg"
    )
    table.add_row("reprojection", f"{found.rms:.3f} px rms")
    table.add_row("views", f"{sum(v.used for v in found.views)} of {len(found.views)} used")
    for view in found.views:
        if not view.used:
            table.add_row("", f"{view.name} does not fit the others ({view.rms:.2f} px)")
    if found.lens_refined:
        table.add_row("intrinsics", "refined: those given predict held-out views worse")
    if found.scale_refined:
        table.add_row("board", f"measures {found.board_scale:.5f} of its nominal size")
    for note in found.notes:
        table.add_row("note", note)
    return table
