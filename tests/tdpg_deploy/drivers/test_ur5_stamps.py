"""Stamps against what is known of the delays."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tdpg_deploy.drivers.ur5_stamps import STEP, WINDOW, Stamps

PERIOD = 0.008  # s


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 0.05), min_size=2, max_size=100), st.floats(-1e6, 1e6))
def test_delays_are_taken_out(delays: list[float], offset: float) -> None:
    """Stamps keep the spacing of the measurements once the least delay has been seen."""
    stamps = Stamps()
    stamp = received = -math.inf
    least = math.inf
    for number, delay in enumerate(delays):
        measured = number * PERIOD
        received = max(measured + offset + delay, received + 2 * STEP)  # in order, as TCP does
        least = min(least, received - measured - offset)
        before, stamp = stamp, stamps.stamp(measured, received)
        assert before < stamp <= received + 1e-6
        assert stamp >= measured + offset + least - 1e-6
    later = len(delays) * PERIOD + 0.1
    last = stamps.stamp(later, later + offset + 0.1)
    assert last == pytest.approx(later + offset + least, abs=1e-6)


def test_old_delays_are_forgotten() -> None:
    """A controller's clock that falls behind is followed."""
    stamps = Stamps()
    stamps.stamp(0.0, 100.0)
    assert stamps.stamp(WINDOW, 100.0 + WINDOW + 0.5) == pytest.approx(100.0 + WINDOW + 0.5)
