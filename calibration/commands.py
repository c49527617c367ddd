"""What the commands of tdpg-calibrate do."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from calibration.collect import Plan, Progress, collect, view_of
from calibration.depth import DepthSamples, fit_depth, sample_depth
from calibration.detect import self_test
from calibration.exchange import (
    export_easy_handeye,
    export_ros,
    export_vpg,
    import_easy_handeye,
    import_vpg,
)
from calibration.file import make_calibration
from calibration.folder import read_lens, read_picture, read_views
from calibration.printing import write_board
from calibration.projection import Estimate
from calibration.record import read_record, record_hash
from calibration.report import ReportInputs, write_html
from calibration.solve import HandEye, solve
from calibration.target import CharucoTarget
from calibration.verify import HeldOut, Jackknife, hold_out, predicted_board
from calibration.views import Mounting, View
from tdpg_deploy.calibration_file import (
    PoseSection,
    check_applies,
    load_calibration,
    save_calibration,
)
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Intrinsics


def run(args: argparse.Namespace, console: Console) -> int:
    commands: dict[str, Callable[[argparse.Namespace, Console], int]] = {
        "board": _board,
        "collect": _collect,
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


def _collect(args: argparse.Namespace, console: Console) -> int:
    # Drivers and simulation are loaded only here, where something moves.
    from calibration.approach import Approach
    from tdpg_deploy.cell import open_cell
    from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell

    self_test()
    config = load_cell(args.config or DEFAULT_CELL)
    x, y = config.workspace.center
    side, table_z = np.linspace(-0.224, 0.224, 5), config.workspace.table_z
    grid = np.stack(np.meshgrid(x + side, y + side, [table_z, table_z + 0.1]), axis=-1)

    def tell(now: Progress) -> None:
        used = "used" if not now.problems else "; ".join(now.problems)
        console.print(
            f"{now.name}: {used}; {now.views} views, {now.deviation * 1e3:.3f} mm predicted"
        )

    with open_cell(config, real=args.real) as cell:
        plan = Plan(
            mounting=Mounting.EYE_TO_HAND,
            target=_target(args),
            guess=Estimate(
                X_parent_camera=config.X_base_camera,
                X_parent_board=Transform.from_rotation_vector(args.board_pose),
                intrinsics=cell.camera.intrinsics,
            ),
            p_workspace=grid.reshape(-1, 3),
            table_z=table_z,
            goal=args.goal,
        )
        rng = np.random.default_rng(args.seed)
        collect(cell, Approach(config, cell.arm), plan, args.record, rng, tell)
    console.print(f"{args.record}: solve it with tdpg-calibrate solve --record {args.record}")
    return 0


def _solve(args: argparse.Namespace, console: Console) -> int:
    self_test()
    target = _target(args)
    taken = _from_record(args, target) if args.record else _from_folder(args, target)
    for name, problems in taken.rejected.items():
        console.print(f"{name}: {'; '.join(problems)}", style="yellow")
    if not taken.views:
        raise CalibrationError(
            f"the board is in none of the {len(taken.rejected)} pictures; see the reasons above"
        )
    corners = target.corners()
    found = solve(taken.views, corners, taken.lens, Mounting(args.mounting))
    checks: tuple[HeldOut, Jackknife] | tuple[None, None] = (None, None)
    depth = None
    try:
        checks = hold_out(found, taken.views, corners, taken.lens)
        if taken.depths:
            depth = fit_depth(_depth_samples(taken, found, target))
    except CalibrationError as error:  # the pose still stands
        console.print(str(error), style="yellow")
    calibration = make_calibration(
        found,
        target,
        serial=taken.serial,
        date=datetime.now(timezone.utc),
        depth=depth,
        record_sha256=record_hash(args.record) if args.record else None,
    )
    save_calibration(calibration, args.out)
    page = write_html(
        ReportInputs(
            found=found,
            views=taken.views,
            board_corners=corners,
            rejected=taken.rejected,
            held_out=checks[0],
            jackknife=checks[1],
            depth=None if depth is None else depth[1],
            pictures=taken.pictures,
        )
    )
    try:
        args.report.write_text(page, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{args.report}: cannot be written ({error.strerror})") from error
    console.print(summary(found))
    console.print(f"{args.out}, {args.report}")
    return 0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Taken:
    """What there is to solve from. pictures (grey) and depths (m) by view name."""

    views: Sequence[View]
    rejected: dict[str, tuple[str, ...]]
    lens: Intrinsics
    serial: str
    pictures: dict[str, npt.NDArray[np.uint8]]
    depths: dict[str, npt.NDArray[np.float32]]


def _from_folder(args: argparse.Namespace, target: CharucoTarget) -> _Taken:
    missing = [name for name in ("images", "poses", "lens") if getattr(args, name) is None]
    if missing:
        raise CalibrationError(f"give --{missing[0]} as well, or --record alone")
    lens = read_lens(args.lens)
    views, rejected = read_views(args.images, args.poses, target, lens)
    return _Taken(
        views=views,
        rejected={picture.name: picture.problems for picture in rejected},
        lens=lens,
        serial=args.serial,
        pictures={view.name: read_picture(args.images / view.name, lens) for view in views},
        depths={},
    )


def _from_record(args: argparse.Namespace, target: CharucoTarget) -> _Taken:
    record = read_record(args.record)
    if not record:
        raise CalibrationError(f"{args.record}: holds no whole view; collect again")
    views, rejected = [], {}
    for recorded in record:
        view, problems = view_of(recorded, target)
        if view is None:
            rejected[recorded.name] = problems
        else:
            views.append(view)
    return _Taken(
        views=views,
        rejected=rejected,
        lens=record[0].intrinsics,
        serial=record[0].serial,
        pictures={r.name: r.color.mean(axis=2).astype(np.uint8) for r in record},
        depths={r.name: r.depth for r in record},
    )


def _depth_samples(taken: _Taken, found: HandEye, target: CharucoTarget) -> list[DepthSamples]:
    used = {view.name for view in found.views if view.used}
    return [
        sample_depth(
            taken.depths[view.name],
            target,
            predicted_board(found, view),
            found.intrinsics,
            found.board_scale,
        )
        for view in taken.views
        if view.name in used
    ]


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
        f"{args.file}: {calibration.mounting}, {calibration.date:%Y-%m-%d}, "
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
