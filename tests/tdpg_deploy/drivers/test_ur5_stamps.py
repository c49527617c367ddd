from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tdpg_deploy.drivers.ur5_stamps import WINDOW, Stamps


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 0.05), min_size=2, max_size=100), st.floats(-1e6, 1e6))
def test_delays_are_taken_out(delays: list[float], offset: float) -> None:
    """Stamps keep the spacing of the measurements once the least delay has been seen."""
    stamps = Stamps()
    times = [0.008 * i for i in range(len(delays))]
    least = min(delays)
    before = -math.inf
    for time, delay in zip(times, delays, strict=True):
        stamp = stamps.stamp(time, time + offset + delay)
        assert stamp <= time + offset + delay + 1e-6
        assert stamp >= time + offset + least - 1e-6
        assert stamp > before
        before = stamp
    last = stamps.stamp(times[-1] + 0.1, times[-1] + 0.1 + offset + 0.05)
    assert last == pytest.approx(times[-1] + 0.1 + offset + least, abs=1e-6)


def test_old_delays_are_forgotten() -> None:
    """A controller's clock that falls behind is followed."""
    stamps = Stamps()
    stamps.stamp(0.0, 100.0)
    assert stamps.stamp(WINDOW, 100.0 + WINDOW + 0.5) == pytest.approx(100.0 + WINDOW + 0.5)
