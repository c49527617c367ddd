"""What the commands of tdpg-calibrate do."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from rich.console import Console

from calibration.board_arguments import target_of
from calibration.board_check import check_board
from calibration.command_collect import run_collect
from calibration.command_solve import run_solve
from calibration.command_touch import run_touch
from calibration.detect import detect, self_test
from calibration.exchange import (
    export_easy_handeye,
    export_ros,
    export_vpg,
    import_easy_handeye,
    import_vpg,
)
from calibration.folder import read_lens, read_picture
from calibration.printing import lay_out_tags, write_board, write_sheet
from tdpg_deploy.calibration_file import PoseSection, check_applies, load_calibration
from tdpg_deploy.errors import CalibrationError


def run(args: argparse.Namespace, console: Console) -> int:
    commands: dict[str, Callable[[argparse.Namespace, Console], int]] = {
        "board": _board,
        "check-board": _check_board,
        "tags": _tags,
        "collect": run_collect,
        "solve": run_solve,
        "touch": run_touch,
        "verify": _verify,
        "import": _import,
        "export": _export,
    }
    return commands[args.command](args, console)


def _board(args: argparse.Namespace, console: Console) -> int:
    write_board(target_of(args), args.file, dpi=args.dpi)
    console.print(f"{args.file}: print at 100 %, then measure the line and a row of squares")
    return 0


def _tags(args: argparse.Namespace, console: Console) -> int:
    write_sheet(lay_out_tags(), args.file)
    console.print(f"{args.file}: print, cut apart, and glue them around the workspace")
    return 0


def _check_board(args: argparse.Namespace, console: Console) -> int:
    target, lens = target_of(args), read_lens(args.lens)
    self_test()
    check = check_board(detect(read_picture(args.photo, lens), target), target, lens, args.measured)
    console.print(
        f"sag {check.sag * 1e3:.2f} mm (sd {check.sag_sd * 1e3:.2f}), rows over columns "
        f"{1 + check.stretch:.5f} (sd {check.stretch_sd:.5f}), {check.rms:.3f} px rms",
        soft_wrap=True,
    )
    if check.scale is None:
        console.print("size not checked: measure a row of squares, and give it as --measured")
    problems = check.problems(target)
    for problem in problems:
        console.print(problem, style="red", markup=False, soft_wrap=True)
    return 1 if problems else 0


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
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        return 1
    quality = calibration.quality
    console.print(
        f"{args.file}: {calibration.mounting}, {calibration.date:%Y-%m-%d}, "
        f"{quality.position_sd * 1e3:.3f} mm, {np.rad2deg(quality.rotation_sd):.4f} deg, "
        f"{quality.views_used} views: applies",
        soft_wrap=True,
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
