"""The board on a command line."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calibration.target import CharucoTarget


def add_board(p: argparse.ArgumentParser, title: str = "the board") -> None:
    group = p.add_argument_group(title)
    group.add_argument("--columns", type=int, default=9, metavar="N", help="squares along a row")
    group.add_argument("--rows", type=int, default=6, metavar="N")
    group.add_argument("--square", type=float, default=0.028, metavar="M", help="metres")
    group.add_argument("--marker", type=float, default=0.021, metavar="M", help="metres")
    group.add_argument("--dictionary", default="DICT_5X5_100", metavar="NAME")
    group.add_argument("--legacy", action="store_true", help="printed before OpenCV 4.6")


def target_of(args: argparse.Namespace) -> CharucoTarget:
    """Raises CalibrationError."""
    from calibration.target import CharucoTarget  # NumPy: not for --help

    return CharucoTarget(
        columns=args.columns,
        rows=args.rows,
        square=args.square,
        marker=args.marker,
        dictionary=args.dictionary,
        legacy=args.legacy,
    )
