from __future__ import annotations

import numpy as np
import pytest
from tables import table_with

from policies.baselines import RandomPolicy
from policies.errors import NoActionError
from policies.primitives import Grasp, Push


def test_random_grasps_are_spread_over_the_object_and_all_directions() -> None:
    heightmap = table_with((100, 100, 20, 20, 0.05))
    rng = np.random.default_rng(0)
    decisions = [RandomPolicy().decide(heightmap, rng) for _ in range(200)]
    assert all(isinstance(decision.primitive, Grasp) for decision in decisions)
    places = np.array([(decision.row, decision.col) for decision in decisions])
    assert places.min(0) == pytest.approx((100, 100), abs=2)
    assert places.max(0) == pytest.approx((119, 119), abs=2)
    assert places.mean(0) == pytest.approx((109.5, 109.5), abs=2)
    counts = np.bincount([decision.rotation for decision in decisions], minlength=8)
    assert len(counts) == 8
    assert counts.min() > 8  # 25 expected


def test_every_other_action_is_a_push_if_wanted() -> None:
    heightmap = table_with((100, 100, 20, 20, 0.05))
    rng = np.random.default_rng(0)
    policy = RandomPolicy(pushes=True)
    pushes = sum(isinstance(policy.decide(heightmap, rng).primitive, Push) for _ in range(100))
    assert 30 < pushes < 70


def test_an_empty_table_offers_nothing() -> None:
    with pytest.raises(NoActionError, match="random"):
        RandomPolicy(pushes=True).decide(table_with(), np.random.default_rng(0))
