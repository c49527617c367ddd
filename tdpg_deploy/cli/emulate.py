"""tdpg-emulate: a whole cell without hardware, for programs that talk to a real one.

A UR controller (RTDE, scripts, dashboard), a Robotiq 2F-85 and a D435 stand before one simulated
table, on a loopback address. Lines on standard input are faults and what people do, such as
protective_stop; docs/emulate.md lists them. Ctrl-C ends it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tdpg_deploy.cli.run import add_table_arguments

FASTEST = 4.0  # docs/emulate.md says why
EXIT_CODES = """
exit codes:
  0  ended by Ctrl-C
  2  bad input: arguments, cell file, scene, or a port is taken
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-emulate",
        description=__doc__,
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument(
        "config", type=Path, nargs="?", metavar="CELL", help="cell file (default: the mock cell)"
    )
    add_table_arguments(p)
    p.set_defaults(goal=False)
    p.add_argument("--seed", type=int, default=0, metavar="N", help="of scene and noise")
    p.add_argument(
        "--pace",
        type=_pace,
        default=1.0,
        metavar="P",
        help="times real time, at most 4 (default: 1)",
    )
    p.add_argument(
        "--model",
        choices=("ur5", "ur5e"),
        help="of the arm (default: the cell file's); a UR5e has an e-series controller",
    )
    p.add_argument(
        "--write-config", type=Path, metavar="FILE", help="the cell file to connect with"
    )
    return p


def _pace(text: str) -> float:
    value = float(text)
    if not 0 < value <= FASTEST:
        raise argparse.ArgumentTypeError(
            f"{value:g} is not within 0 to {FASTEST:g}: the faster the cell, the later its clients "
            "feel a contact"
        )
    return value


def main(argv: Sequence[str] | None = None) -> int:
    args = parser().parse_args(argv)

    from tdpg_deploy.cli.emulation import run_emulation  # heavy: not for --help

    return run_emulation(args)


if __name__ == "__main__":
    sys.exit(main())
