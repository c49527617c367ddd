from __future__ import annotations

import numpy as np
import pytest

from policies.heightmap import SIZE
from policies.networks.build import build
from policies.policy import ROTATIONS
from tools.benchmark.decision import cluttered_table, one_by_one


@pytest.mark.parametrize("kind", ["light", "twin"])
def test_the_reference_values_all_actions(kind: str) -> None:
    """A twin's pushes come at another stride than its grasps."""
    maps = one_by_one(build(kind, goal=False, width=4), cluttered_table(np.random.default_rng(0)))
    assert len(maps) == ROTATIONS
    for push, grasp in maps:
        assert push.shape == grasp.shape == (1, 1, SIZE, SIZE)
