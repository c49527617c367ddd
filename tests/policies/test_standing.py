from __future__ import annotations

import numpy as np
from tables import table_with

from policies.standing import rising, within

BLOCK = (100, 100, 20, 20, 0.05)


def test_what_rises_is_the_block_alone() -> None:
    heightmap = table_with(BLOCK)
    heightmap.height[10, 10] = 0.03  # a speck
    heightmap.height[30:60, 30:60] = np.nan  # a hole
    heightmap.height[:, 200:] = 0.004  # noise of the table
    rows, cols = np.nonzero(rising(heightmap))
    # The corner pixels of a square have three neighbours.
    assert len(rows) == 20 * 20 - 4
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (100, 119, 100, 119)


def test_what_lies_within_a_distance_lies_in_a_square_around_any_pixel() -> None:
    shown = np.zeros((224, 224), np.bool_)
    shown[[10, 200], [20, 0]] = True
    rows, cols = np.nonzero(within(0.006, shown))
    near = (abs(rows - 10) <= 3) & (abs(cols - 20) <= 3)
    assert near.sum() == 7 * 7
    assert (~near).sum() == 7 * 4  # cut by the border
