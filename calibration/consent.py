"""Asked before a real arm moves for a calibration."""

from __future__ import annotations

import sys

from rich.console import Console

from tdpg_deploy.errors import CalibrationError


def ask_consent(console: Console, what: str, *, real: bool) -> None:
    """what: is going to happen. A simulated cell may always. Raises CalibrationError without a
    yes."""
    if not real:
        return
    console.print(f"{what}\nKeep clear, and a hand at the emergency stop. Ctrl-C stops the arm.")
    if not sys.stdin.isatty():
        raise CalibrationError("--real asks before it moves, and nobody can answer here")
    if console.input("Type yes to go on: ").strip().lower() != "yes":
        raise CalibrationError("nothing was moved: the answer was not yes")
