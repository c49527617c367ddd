from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable

import pytest

from tdpg_deploy.arguments import above_zero, positive, whole


@pytest.mark.parametrize(
    ("parsed", "text", "value"),
    [
        (positive, "1", 1),
        (positive, "999999999", 999_999_999),
        (whole(1, 30), "1", 1),
        (whole(1, 30), "30", 30),
        (above_zero(1), "1", 1.0),
        (above_zero(1), "2.5e-1", 0.25),
    ],
)
def test_what_is_asked_for_is_taken(
    parsed: Callable[[str], float], text: str, value: float
) -> None:
    assert parsed(text) == value


@pytest.mark.parametrize("text", ["0", "-1", "two", "", "1.5", "9" * 5000])
def test_what_is_no_count_is_told(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="is not a whole number from 1 on"):
        positive(text)


@pytest.mark.parametrize("text", ["0", "31", "two", "", "9" * 5000])
def test_what_is_no_such_count_is_told(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="is not a whole number from 1 to 30"):
        whole(1, 30)(text)


@pytest.mark.parametrize("text", ["0", "1.01", "-0.5", "nan", "inf", "half", ""])
def test_what_is_no_share_is_told(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="is not a number above 0 and up to 1"):
        above_zero(1)(text)
