"""tdpg-calibrate: print a board, find the camera's pose and how well it is known, check it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from calibration.board_arguments import add_board

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
    add_board(board)

    tags = commands.add_parser("tags", help="write tags for the table to print, PDF or PNG")
    tags.add_argument("file", type=Path)

    check = commands.add_parser("check-board", help="is the printed board flat, and of its size?")
    check.add_argument("photo", type=Path, help="the whole board, tilted by some 30 degrees")
    check.add_argument("--lens", type=Path, required=True, metavar="FILE", help="as for solve")
    check.add_argument(
        "--measured", type=float, metavar="M", help="length of a whole row of squares, by a ruler"
    )
    add_board(check)

    _add_collect(commands.add_parser("collect", help="record views, by the arm or by hand"))

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
    _add_mounting(solve)
    solve.add_argument("--serial", help="of the camera; a record holds it")
    solve.add_argument("--arm-serial", metavar="SERIAL", help="kept in the file")
    solve.add_argument(
        "--table", type=Path, metavar="FILE", help="a picture of the table with its tags"
    )
    solve.add_argument("--out", type=Path, default=Path("calibration.yaml"), metavar="FILE")
    solve.add_argument("--report", type=Path, default=Path("calibration.html"), metavar="FILE")
    add_board(solve, "the board (a record says itself which)")

    touch = commands.add_parser("touch", help="come down on 5 to 9 things that the camera sees")
    touch.add_argument("--config", type=Path, metavar="FILE", help="cell file (default: the mock)")
    touch.add_argument("--real", action="store_true", help="move the real arm; asks first")
    touch.add_argument("--scene", type=Path, metavar="FILE", help="what lies on the mock's table")

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


def _add_collect(p: argparse.ArgumentParser) -> None:
    p.add_argument("--config", type=Path, metavar="FILE", help="cell file (default: the mock cell)")
    p.add_argument("--record", type=Path, default=Path("calibration.mcap"), metavar="FILE")
    _add_mounting(p)
    poses = {
        "--board-pose": "first guess: the held board in the tool; with eye-in-hand, the board on "
        "the table in base; m, rad",
        "--camera-pose": "first guess: the camera in base, or in the tool (default: the cell "
        "file's, in base)",
        "--paint-board": "simulated cells: where the board really is; it is painted into the "
        "pictures",
    }
    for name, meaning in poses.items():
        axes = ("X", "Y", "Z", "RX", "RY", "RZ")
        p.add_argument(name, type=float, nargs=6, metavar=axes, help=meaning)
    p.add_argument("--goal", type=float, default=1e-4, metavar="M", help="predicted error")
    p.add_argument("--by-hand", action="store_true", help="you move the arm, and say when to look")
    p.add_argument("--seed", type=int, default=0, metavar="N")
    p.add_argument("--real", action="store_true", help="the real cell")
    add_board(p)


def _add_mounting(p: argparse.ArgumentParser) -> None:
    p.add_argument("--mounting", choices=["eye-to-hand", "eye-in-hand"], default="eye-to-hand")


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
