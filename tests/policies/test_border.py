from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from tables import table_with

from policies.border import border_norm, border_occupancy
from policies.heightmap import SIZE


def test_what_stands_around_the_goal_is_counted() -> None:
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[100:120, 100:120] = True
    alone = table_with((100, 100, 20, 20, 0.05), goal=goal)
    assert border_occupancy(alone) == border_norm(alone) == 0
    # A neighbour all along one side: 20 x 5 of the 30 x 30 - 20 x 20 pixels of border.
    beside = table_with((100, 100, 20, 40, 0.05), goal=goal)
    assert border_occupancy(beside) == pytest.approx(100 / 500, abs=0.01)
    assert border_norm(beside) == pytest.approx(100 / 400, abs=0.01)
    assert border_occupancy(table_with((0, 0, 224, 224, 0.05), goal=goal)) == 1
    for without in (None, np.zeros((SIZE, SIZE), np.bool_)):
        nothing = dataclasses.replace(alone, goal=without)
        assert border_occupancy(nothing) == border_norm(nothing) == 0
