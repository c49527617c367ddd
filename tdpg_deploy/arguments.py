"""Types of command-line arguments, whose errors say what is asked for."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable


def positive(text: str) -> int:
    if not _is_whole(text) or int(text) < 1:
        raise ArgumentTypeError(f"{text} is not a whole number from 1 on")
    return int(text)


def whole(least: int, most: int) -> Callable[[str], int]:
    """Of least to most, both allowed."""

    def parsed(text: str) -> int:
        if not _is_whole(text) or not least <= int(text) <= most:
            raise ArgumentTypeError(f"{text} is not a whole number from {least} to {most}")
        return int(text)

    return parsed


def above_zero(most: float) -> Callable[[str], float]:
    """Numbers above 0; most is allowed."""

    def parsed(text: str) -> float:
        try:
            if 0 < float(text) <= most:
                return float(text)
        except ValueError:
            pass
        raise ArgumentTypeError(f"{text} is not a number above 0 and up to {most:g}")

    return parsed


def _is_whole(text: str) -> bool:
    return text.isdecimal() and len(text) < 10
