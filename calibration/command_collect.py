"""tdpg-calibrate collect: on a cell, by the arm's own motion or by hand."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.live import Live

from calibration.approach import Approach
from calibration.board_arguments import target_of
from calibration.board_camera import BoardCell, PaintedBoard
from calibration.collect import collect, collect_by_hand
from calibration.collection import Devices, Plan, Progress, wanted_points
from calibration.consent import ask_consent
from calibration.detect import self_test
from calibration.live import draw, panel, write_picture
from calibration.projection import Estimate
from calibration.record import Setup
from calibration.views import Mounting
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Transform


def run_collect(args: argparse.Namespace, console: Console) -> int:
    from tdpg_deploy.cell import open_cell  # drivers or simulation: only where something moves

    self_test()
    config = uncalibrated(load_cell(args.config or DEFAULT_CELL))
    setup = Setup(
        mounting=Mounting(args.mounting), target=target_of(args), workspace=config.workspace
    )
    camera, board = first_guess(args, config)
    rng = np.random.default_rng(args.seed)
    if not args.by_hand:
        what = (
            "The arm is going to move through some 15 poses, by way of home. The check of its "
            "motions knows neither the board nor the cables."
        )
        ask_consent(console, what, real=args.real)
    with open_cell(config, real=args.real) as cell:
        lens = cell.camera.intrinsics
        plan = Plan(
            setup=setup,
            guess=Estimate(X_parent_camera=camera, X_parent_board=board, intrinsics=lens),
            p_workspace=wanted_points(setup, camera, lens),
            goal=args.goal,
        )
        approach, path = Approach(config, cell.arm), args.record
        devices = cell if args.paint_board is None else _with_board(cell, args, plan, config)
        with Live(console=console, auto_refresh=False) as live:

            def tell(progress: Progress) -> None:
                live.update(panel(progress, plan), refresh=True)
                write_picture(draw(progress, plan.target, lens), path.with_suffix(".png"))

            if args.by_hand:
                ask = _asker(console, live)
                reach, hides = approach.reach_by_hand, approach.hides
                collect_by_hand(devices, reach, hides, plan, path, rng, tell, ask)
            else:
                collect(devices, approach, plan, path, rng, tell)
    console.print(f"\n{path}: solve it with tdpg-calibrate solve --record {path}")
    return 0


def uncalibrated(config: CellConfig) -> CellConfig:
    """The cell without the corrections of an earlier calibration; its pose stays as a guess."""
    camera = config.camera.model_copy(update={"calibration": None})
    return config.model_copy(update={"camera": camera})


def first_guess(args: argparse.Namespace, config: CellConfig) -> tuple[Transform, Transform]:
    """X_parent_camera and X_parent_board."""
    in_hand = Mounting(args.mounting) is Mounting.EYE_IN_HAND
    if args.board_pose is None and not args.by_hand:
        where = "base" if in_hand else "the tool"
        raise CalibrationError(
            f"give --board-pose, the board in {where} to some centimetres, or --by-hand"
        )
    if args.camera_pose is None and in_hand:
        raise CalibrationError("give --camera-pose, the camera in the tool to some centimetres")
    camera = (
        config.X_base_camera
        if args.camera_pose is None
        else Transform.from_rotation_vector(args.camera_pose)
    )
    return camera, Transform.from_rotation_vector(args.board_pose or [0.0] * 6)


def _with_board(cell: Devices, args: argparse.Namespace, plan: Plan, config: CellConfig) -> Devices:
    """A simulated cell that sees a board where --paint-board says."""
    in_base = plan.setup.mounting is Mounting.EYE_TO_HAND
    true_pose = config.simulation.X_base_camera or config.camera.X_base_camera
    board = PaintedBoard(
        mounting=plan.setup.mounting,
        target=plan.target,
        X_parent_camera=true_pose.transform() if in_base else plan.guess.X_parent_camera,
        X_parent_board=Transform.from_rotation_vector(args.paint_board),
    )
    return BoardCell(cell.camera, cell.arm, cell.clock, board)


def _asker(console: Console, live: Live) -> Callable[[], bool]:
    def ask() -> bool:
        live.stop()  # it would write over the question
        answer = console.input("Enter: take a picture with the arm at rest; f: finish. ")
        live.start()
        return answer.strip().lower() != "f"

    return ask
