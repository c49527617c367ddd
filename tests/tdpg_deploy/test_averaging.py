from __future__ import annotations

import numpy as np
import numpy.typing as npt
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from tdpg_deploy.averaging import mean_depth

Stack = npt.NDArray[np.float32]


def stacks(low: float, high: float) -> st.SearchStrategy[Stack]:
    depths = st.one_of(st.just(np.nan), st.floats(low, high, width=32))
    return st.integers(1, 7).flatmap(lambda n: npst.arrays(np.float32, (n, 3, 4), elements=depths))


@given(stacks(0.75, 0.7578125))
@settings(deadline=None)  # the first call compiles
def test_the_mean_is_numpys_where_most_frames_saw_one_surface(stack: Stack) -> None:
    mean = mean_depth(list(stack))
    most = np.isfinite(stack).sum(axis=0) > len(stack) / 2
    assert (np.isfinite(mean) == most).all()
    np.testing.assert_allclose(mean[most], np.nanmean(stack[:, most], axis=0), rtol=1e-6)


@given(stacks(0.25, 2.0))
@settings(deadline=None)  # the first call compiles
def test_a_mean_is_always_of_one_surface(stack: Stack) -> None:
    """More than half of the frames agree with it, whatever the others say."""
    mean = mean_depth(list(stack))
    known = np.isfinite(mean)
    near = np.abs(stack[:, known] - mean[known]) <= 0.04 * mean[known] + 1e-6
    assert (near.sum(axis=0) > len(stack) / 2).all()


def test_an_edge_that_trembles_is_not_put_in_between() -> None:
    block, table = np.float32(0.65), np.float32(0.70)
    stack = [np.full((1, 1), block if k < 3 else table) for k in range(8)]
    assert mean_depth(stack)[0, 0] == table
    assert np.isnan(mean_depth(stack[:6])[0, 0])  # three against three: nobody knows
