"""What the commands of tdpg-calibrate do."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from datetime import datetime, timezone

import numpy as np
from rich.console import Console
from rich.table import Table

from calibration.detect import self_test
from calibration.exchange import (
    export_easy_handeye,
    export_ros,
    export_vpg,
    import_easy_handeye,
    import_vpg,
)
from calibration.file import (
    PoseSection,
    check_applies,
    load_calibration,
    make_calibration,
    save_calibration,
)
from calibration.folder import read_lens, read_picture, read_views
from calibration.printing import write_board
from calibration.report import ReportInputs, write_html
from calibration.solve import HandEye, solve
from calibration.target import CharucoTarget
from calibration.verify import HeldOut, Jackknife, hold_out
from calibration.views import Mounting
from tdpg_deploy.errors import CalibrationError


def run(args: argparse.Namespace, console: Console) -> int:
    commands: dict[str, Callable[[argparse.Namespace, Console], int]] = {
        "board": _board,
        "solve": _solve,
        "verify": _verify,
        "import": _import,
        "export": _export,
    }
    return commands[args.command](args, console)


def _target(args: argparse.Namespace) -> CharucoTarget:
    return CharucoTarget(
        columns=args.columns,
        rows=args.rows,
        square=args.square,
        marker=args.marker,
        dictionary=args.dictionary,
        legacy=args.legacy,
    )


def _board(args: argparse.Namespace, console: Console) -> int:
    write_board(_target(args), args.file, dpi=args.dpi)
    console.print(f"{args.file}: print at 100 %, then measure the line and a row of squares")
    return 0


def _solve(args: argparse.Namespace, console: Console) -> int:
    self_test()
    target, lens = _target(args), read_lens(args.lens)
    views, rejected = read_views(args.images, args.poses, target, lens)
    for picture in rejected:
        console.print(f"{picture.name}: {'; '.join(picture.problems)}", style="yellow")
    if not views:
        raise CalibrationError(
            f"the board is in none of the {len(rejected)} pictures; see the reasons above"
        )
    corners = target.corners()
    found = solve(views, corners, lens, Mounting(args.mounting))
    checks: tuple[HeldOut, Jackknife] | tuple[None, None] = (None, None)
    try:
        checks = hold_out(found, views, corners, lens)
    except CalibrationError as error:  # a result from few views still stands
        console.print(str(error), style="yellow")
    calibration = make_calibration(
        found, target, serial=args.serial, date=datetime.now(timezone.utc)
    )
    save_calibration(calibration, args.out)
    page = write_html(
        ReportInputs(
            found=found,
            views=views,
            board_corners=corners,
            rejected={picture.name: picture.problems for picture in rejected},
            held_out=checks[0],
            jackknife=checks[1],
            pictures={view.name: read_picture(args.images / view.name, lens) for view in views},
        )
    )
    try:
        args.report.write_text(page, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{args.report}: cannot be written ({error.strerror})") from error
    console.print(summary(found))
    console.print(f"{args.out}, {args.report}")
    return 0


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


def _verify(args: argparse.Namespace, console: Console) -> int:
    calibration = load_calibration(args.file)
    width, height = _size(args.size)
    try:
        check_applies(
            calibration,
            serial=args.serial or calibration.camera.serial,
            width=width,
            height=height,
        )
    except CalibrationError as error:
        console.print(str(error), style="red", markup=False)
        return 1
    quality = calibration.quality
    console.print(
        f"{args.file}: {calibration.mounting.value}, {calibration.date:%Y-%m-%d}, "
        f"{quality.position_sd * 1e3:.3f} mm, {np.rad2deg(quality.rotation_sd):.4f} deg, "
        f"{quality.views_used} views: applies"
    )
    return 0


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise CalibrationError(f"--size {text}: give width x height, such as 1280x720")
    return int(width), int(height)


def _import(args: argparse.Namespace, console: Console) -> int:
    if args.source == "vpg":
        pose = import_vpg(args.file, args.depth_scale)
    else:
        pose = import_easy_handeye(args.file)
    section = PoseSection.of(pose.X_parent_camera)
    console.print(
        f"{pose.mounting.value}; depth scale {pose.depth_scale:.6f}; its error is unknown"
    )
    console.print(
        f"X_{pose.mounting.camera_parent}_camera = {{ position = {list(section.position)}, "
        f"quaternion = {list(section.quaternion)} }}",
        soft_wrap=True,
        markup=False,
    )
    return 0


def _export(args: argparse.Namespace, console: Console) -> int:
    calibration = load_calibration(args.file)
    if args.to == "vpg":
        pose, scale = export_vpg(calibration)
        texts = {args.out: pose, args.out.with_name("camera_depth_scale.txt"): scale}
    else:
        write = export_ros if args.to == "ros" else export_easy_handeye
        texts = {args.out: write(calibration)}
    for path, text in texts.items():
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise CalibrationError(f"{path}: cannot be written ({error.strerror})") from error
        console.print(str(path))
    return 0
