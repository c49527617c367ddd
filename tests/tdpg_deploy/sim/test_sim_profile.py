from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tdpg_deploy.sim.profile import trapezoid

STEP = 1 / 240


@given(
    length=st.floats(1e-4, 3),
    speed=st.floats(0.01, 3),
    acceleration=st.floats(0.1, 10),
)
def test_never_faster_or_harder_than_asked(
    length: float, speed: float, acceleration: float
) -> None:
    way = np.concatenate([[0.0], trapezoid(length, speed, acceleration, STEP)]) * length
    velocity = np.diff(way) / STEP
    assert way[-1] == length
    assert velocity.min() >= -1e-9
    assert velocity.max() <= speed * (1 + 1e-9)
    assert np.abs(np.diff(velocity)).max(initial=0) / STEP <= acceleration * (1 + 1e-6)


def test_takes_the_textbook_time() -> None:
    # 0.5 m at 0.25 m/s and 0.5 m/s^2: 0.5 s up, 0.5 s down, and 0.375 m at speed.
    assert_allclose(
        len(trapezoid(0.5, 0.25, 0.5, STEP)) * STEP, 0.5 + 0.5 + 0.375 / 0.25, atol=STEP
    )
    # 0.1 m at 2 m/s and 1 m/s^2 never reaches its speed: 2 sqrt(l / a).
    assert_allclose(len(trapezoid(0.1, 2, 1, STEP)) * STEP, 2 * np.sqrt(0.1), atol=STEP)


def test_no_way_takes_no_time() -> None:
    assert len(trapezoid(0.0, 1, 1, STEP)) == 0
