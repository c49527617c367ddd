"""tdpg-calibrate: print a board, find the camera's pose and how well it is known, check it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

EPILOG = """
exit codes:
  0    done
  1    the check failed: the calibration does not hold
  2    bad input: arguments, pictures, poses, files; the message says what to do
  3    a device failed; the arm was stopped
  130  stopped by the operator (Ctrl-C)
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-calibrate",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = p.add_subparsers(dest="command", required=True, metavar="COMMAND")

    board = commands.add_parser("board", help="write the board to print, PDF or PNG")
    board.add_argument("file", type=Path)
    board.add_argument("--dpi", type=int, default=600, help="of a PNG (default: 600)")
    _add_board(board)

    collect = commands.add_parser(
        "collect", help="let the arm show a held board to the fixed camera, and record views"
    )
    collect.add_argument(
        "--config", type=Path, metavar="FILE", help="cell file; its camera pose is the first guess"
    )
    collect.add_argument("--record", type=Path, default=Path("calibration.mcap"), metavar="FILE")
    collect.add_argument(
        "--board-pose",
        type=float,
        nargs=6,
        required=True,
        metavar=("X", "Y", "Z", "RX", "RY", "RZ"),
        help="first guess of the board in the tool; m, rad",
    )
    collect.add_argument("--goal", type=float, default=1e-4, metavar="M", help="predicted error")
    collect.add_argument("--seed", type=int, default=0, metavar="N")
    collect.add_argument("--real", action="store_true", help="move the real arm")
    _add_board(collect)

    solve = commands.add_parser("solve", help="solve from pictures and poses in files")
    solve.add_argument("--record", type=Path, metavar="FILE", help="an MCAP of `collect`, instead")
    solve.add_argument("--images", type=Path, metavar="DIR")
    solve.add_argument(
        "--poses",
        type=Path,
        metavar="FILE",
        help="CSV: image,x,y,z,rx,ry,rz (rotation vector) or image,x,y,z,qx,qy,qz,qw; m, rad",
    )
    solve.add_argument("--lens", type=Path, metavar="FILE", help="YAML: fx, fy, cx, cy, ...")
    solve.add_argument("--mounting", choices=["eye-to-hand", "eye-in-hand"], default="eye-to-hand")
    solve.add_argument("--serial", default="unknown", help="of the camera")
    solve.add_argument("--out", type=Path, default=Path("calibration.yaml"), metavar="FILE")
    solve.add_argument("--report", type=Path, default=Path("calibration.html"), metavar="FILE")
    _add_board(solve)

    verify = commands.add_parser("verify", help="read a calibration file and say if it applies")
    verify.add_argument("file", type=Path)
    verify.add_argument("--serial", help="of the camera that will be used")
    verify.add_argument("--size", default="1280x720", metavar="WxH", help="of its pictures")

    read = commands.add_parser("import", help="show another program's calibration as our pose")
    read.add_argument("--from", dest="source", choices=["easy-handeye", "vpg"], required=True)
    read.add_argument("file", type=Path)
    read.add_argument("--depth-scale", type=Path, metavar="FILE", help="VPG's second file")

    write = commands.add_parser("export", help="write a calibration for another program")
    write.add_argument("--to", choices=["easy-handeye", "vpg", "ros"], required=True)
    write.add_argument("file", type=Path)
    write.add_argument("--out", type=Path, required=True, metavar="FILE")
    return p


def _add_board(p: argparse.ArgumentParser) -> None:
    group = p.add_argument_group("the board")
    group.add_argument("--columns", type=int, default=9, help="squares along a row")
    group.add_argument("--rows", type=int, default=6)
    group.add_argument("--square", type=float, default=0.028, metavar="M", help="metres")
    group.add_argument("--marker", type=float, default=0.021, metavar="M", help="metres")
    group.add_argument("--dictionary", default="DICT_5X5_100")
    group.add_argument("--legacy", action="store_true", help="printed before OpenCV 4.6")


def main(argv: Sequence[str] | None = None) -> int:
    args = parser().parse_args(argv)

    from rich.console import Console

    from calibration import commands
    from tdpg_deploy.errors import DeviceError, TdpgError

    console = Console()
    try:
        return commands.run(args, console)
    except DeviceError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        return 3
    except TdpgError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
