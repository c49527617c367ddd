"""tdpg-run: clear a table, or fetch one object; one log per episode."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tdpg_deploy.arguments import above_zero, positive, whole

EXIT_CODES = """
exit codes:
  0    every episode reached its end: table cleared, or goal fetched
  1    at least one episode ended short of it (stuck, no action, limits)
  2    bad input: arguments, cell file, scene, checkpoint, calibration
  3    a device failed; the arm was stopped and the log is closed
  4    the log could not be written (disk full?); the arm was stopped
  130  stopped by the operator (Ctrl-C); the arm was stopped and the log is closed
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-run",
        description=__doc__,
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument(
        "--policy",
        metavar="FILE",
        help='a frozen checkpoint, or "random" (default: a shipped one, with --goal another)',
    )
    p.add_argument("--config", type=Path, metavar="FILE", help="cell file (default: the mock cell)")
    p.add_argument("--goal", action="store_true", help="fetch the scene's goal object, then stop")
    p.add_argument("--episodes", type=positive, default=1, metavar="N")
    p.add_argument("--seed", type=int, default=0, metavar="N", help="of scene, noise and choices")
    p.add_argument("--out", type=Path, default=Path("logs"), metavar="DIR", help="for the logs")

    add_table_arguments(p)

    real = p.add_argument_group("the real cell")
    real.add_argument("--real", action="store_true", help="move the real arm; asks first")
    real.add_argument("--step", action="store_true", help="ask before each action")
    real.add_argument(
        "--speed",
        type=above_zero(1),
        metavar="SHARE",
        help="of the cell file's speed limits (default: 0.25 with --real, else 1)",
    )
    real.add_argument(
        "--unattended", action="store_true", help="do not ask: nobody stands by the arm"
    )
    return p


def add_table_arguments(p: argparse.ArgumentParser) -> None:
    """--objects or --scene."""
    mock = p.add_argument_group("the simulated table")
    table = mock.add_mutually_exclusive_group()
    table.add_argument(
        "--objects", type=whole(1, 30), default=10, metavar="N", help="1 to 30, random"
    )
    table.add_argument("--scene", type=Path, metavar="FILE", help="a scene file")


def main(argv: Sequence[str] | None = None) -> int:
    args = parser().parse_args(argv)

    from tdpg_deploy.cli.session import run_session  # heavy: not for --help

    return run_session(args)


if __name__ == "__main__":
    sys.exit(main())
