from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from tables import goal_at, table_with

from policies.coordinator import GRASP, PUSH, Coordinator, coordinated, situation
from policies.heightmap import Heightmap
from policies.learned import LearnedPolicy
from policies.methods import METHODS
from policies.networks.coordinated import CoordinatedNet
from policies.networks.light import LightNet
from policies.policy import Choice
from policies.primitives import Grasp, Push

ON_GOAL = Choice(kind="grasp", rotation=0, row=110, col=110, q=0.7)
BESIDE = Choice(kind="grasp", rotation=0, row=110, col=130, q=1.2)
A_PUSH = Choice(kind="push", rotation=0, row=150, col=110, q=0.4)
FAILED = Grasp(x=0.5, y=0.0, z=0.0, yaw=0.0)
REFUSED = Push(x=0.5, y=0.0, z=0.0, yaw=0.0)


@pytest.fixture
def hemmed_in() -> Heightmap:
    """A goal of 20 x 20 pixels with a neighbour all along one side."""
    goal = goal_at(slice(100, 120), slice(100, 120))
    return table_with((100, 100, 20, 40, 0.05), goal=goal)


def knows(part: int, above: float) -> Coordinator:
    """Grasps if that part of a situation exceeds `above`."""
    coordinator = Coordinator()
    for parameter in coordinator.parameters():
        torch.nn.init.zeros_(parameter)
    weights = coordinator.state_dict()
    weights["0.weight"][0, part] = 1.0
    weights["2.weight"][0, 0] = 1.0
    weights["4.weight"][GRASP, 0] = 1.0
    weights["4.bias"][PUSH] = above
    return coordinator


def test_a_situation_is_what_gi_looks_at(hemmed_in: Heightmap) -> None:
    seen = situation(ON_GOAL, A_PUSH, hemmed_in, [FAILED, REFUSED, FAILED])
    np.testing.assert_allclose(seen, [0.4, 0.7, 0.2, 0.25, 2], atol=0.01)


@pytest.mark.parametrize(
    ("part", "above", "expected"),
    [(1, 0.6, ON_GOAL), (1, 0.8, A_PUSH), (3, 0.2, ON_GOAL), (4, 0.5, ON_GOAL), (4, 1.5, A_PUSH)],
)
def test_it_grasps_the_goal_if_that_is_likelier_to_succeed(
    hemmed_in: Heightmap, part: int, above: float, expected: Choice
) -> None:
    choose = knows(part, above)
    assert coordinated(choose, [ON_GOAL, BESIDE], A_PUSH, hemmed_in, [FAILED]) is expected


def test_what_is_not_allowed_is_not_chosen(hemmed_in: Heightmap) -> None:
    never, always = knows(0, 9.0), knows(0, -9.0)
    assert coordinated(never, [ON_GOAL], None, hemmed_in, []) is ON_GOAL
    assert coordinated(always, [BESIDE], A_PUSH, hemmed_in, []) is A_PUSH
    assert coordinated(always, [BESIDE], None, hemmed_in, []) is BESIDE
    assert coordinated(always, [], None, hemmed_in, []) is None
    cleared = dataclasses.replace(hemmed_in, goal=None)
    assert coordinated(always, [BESIDE, ON_GOAL], A_PUSH, cleared, []) is BESIDE


@pytest.mark.parametrize(("above", "expected"), [(-9.0, Grasp), (9.0, Push)])
def test_a_policy_does_as_its_coordinator_says(above: float, expected: type) -> None:
    torch.manual_seed(3)
    network = CoordinatedNet(goal=True)
    network.coordinator = knows(2, above)
    free = table_with((90, 100, 20, 20, 0.05), goal=goal_at(slice(90, 110), slice(100, 120)))
    for dtype in (torch.float32, torch.bfloat16):
        policy = LearnedPolicy(network, METHODS["gi"], goal=True, dtype=dtype)
        decision = policy.decide(free, np.random.default_rng(0))
        assert isinstance(decision.primitive, expected)
        assert decision.verdict is None


def test_gi_needs_a_coordinator() -> None:
    with pytest.raises(ValueError, match="gi needs a network with a coordinator"):
        LearnedPolicy(LightNet(goal=True), METHODS["gi"], goal=True)
