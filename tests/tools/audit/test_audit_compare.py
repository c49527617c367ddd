from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.audit.compare import difference
from tools.evaluate.metrics import Estimate, share


def test_newcombes_own_example() -> None:
    """56/70 against 48/80: 0.2000, 0.0524 to 0.3339 (Newcombe 1998, table II, method 10)."""
    result = difference(share(48, 80), share(56, 70))
    assert result.value == pytest.approx(0.2)
    assert result.low == pytest.approx(0.0524, abs=5e-5)
    assert result.high == pytest.approx(0.3339, abs=5e-5)


def test_a_share_of_nothing_is_unknown() -> None:
    assert math.isnan(share(0, 0).value)


estimates = (
    st.tuples(*[st.floats(-100, 100)] * 3)
    .map(sorted)
    .map(lambda v: Estimate(low=v[0], value=v[1], high=v[2]))
)


@given(estimates, estimates)
def test_exchanging_the_sets_changes_the_sign(one: Estimate, other: Estimate) -> None:
    there, back = difference(one, other), difference(other, one)
    assert (there.low, there.value, there.high) == (-back.high, -back.value, -back.low)
    assert there.low <= there.value <= there.high
