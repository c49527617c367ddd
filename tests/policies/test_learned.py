from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from tables import goal_at, table_with

from policies import state
from policies.decide import best_grasps
from policies.errors import HeightmapError, NoActionError
from policies.heightmap import SIZE, Heightmap
from policies.learned import LearnedPolicy
from policies.methods import METHODS
from policies.networks.light import LightNet
from policies.networks.maps import Maps, Network
from policies.policy import Decision
from policies.primitives import Grasp, Push

CLUTTER = [(60, 60, 25, 15, 0.05), (80, 70, 15, 25, 0.03), (150, 120, 25, 25, 0.06)]


class KnowsWhatItWants(Network):
    """Values that can be worked out by hand.

    A grasp is worth the height of the pixel; a push, red seen 20 pixels ahead (up in the
    picture). Critic II believes in every grasp with the same probability.
    """

    def __init__(self, *, push_weight: float = 0.0, p_success: float = 0.5) -> None:
        super().__init__()
        self.push_weight = push_weight
        self.logit = float(np.log(p_success / (1 - p_success)))

    def forward(self, picture: torch.Tensor) -> Maps:
        red = picture[:, state.RED : state.RED + 1]
        ahead = torch.roll(red, 20, dims=2)
        grasp = picture[:, state.HEIGHT : state.HEIGHT + 1]
        return Maps(push=self.push_weight * ahead, grasp=grasp, features=picture)

    def evaluate(self, features: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        return torch.full((len(places),), self.logit)


def policy_of(network: Network, method: str = "tdpg", *, goal: bool = False) -> LearnedPolicy:
    return LearnedPolicy(network, METHODS[method], goal=goal, dtype=torch.float32)


def decide(policy: LearnedPolicy, heightmap: Heightmap, seed: int = 0) -> Decision:
    return policy.decide(heightmap, np.random.default_rng(seed))


def trained_light(*, goal: bool = False) -> LightNet:
    torch.manual_seed(3)
    return LightNet(goal=goal)


def test_it_grasps_what_is_worth_most() -> None:
    decision = decide(policy_of(KnowsWhatItWants()), table_with(*CLUTTER))
    assert isinstance(decision.primitive, Grasp)
    assert 150 <= decision.row < 175
    assert 120 <= decision.col < 145
    assert decision.q == pytest.approx(0.06 * state.HEIGHT_SCALE, rel=0.01)
    assert decision.primitive.z == pytest.approx(-0.15 + 0.06)
    x, y = table_with().workspace.to_base(decision.row, decision.col)
    assert (decision.primitive.x, decision.primitive.y) == (float(x), float(y))


@pytest.mark.parametrize("method", ["grasp-only", "vpg"])
def test_a_grasp_has_the_same_value_from_both_sides(method: str) -> None:
    maps = decide(policy_of(trained_light(), method), table_with(*CLUTTER)).maps
    np.testing.assert_array_equal(maps.grasp[:8], maps.grasp[8:])
    assert np.isneginf(maps.push).all() == (method == "grasp-only")


def test_it_pushes_towards_what_it_wants_to_push() -> None:
    heightmap = table_with(*CLUTTER[:2])
    heightmap.color[:] = 0
    heightmap.color[80:95, 70:95, 0] = 255
    wants_red = policy_of(KnowsWhatItWants(push_weight=10.0), "vpg")
    decision = decide(wants_red, heightmap)
    assert isinstance(decision.primitive, Push)
    ahead_x = decision.primitive.x + 0.04 * np.cos(decision.primitive.yaw)
    ahead_y = decision.primitive.y + 0.04 * np.sin(decision.primitive.yaw)
    row, col = heightmap.workspace.to_pixel(ahead_x, ahead_y)
    assert 79 <= row <= 95
    assert 69 <= col <= 95


def test_critic_two_swaps_both_ways_and_says_so() -> None:
    heightmap = table_with(*CLUTTER)
    doubted = decide(policy_of(KnowsWhatItWants(p_success=0.3)), heightmap)
    assert isinstance(doubted.primitive, Push)
    assert doubted.verdict is not None
    assert doubted.verdict.overruled
    assert doubted.verdict.p_success == pytest.approx([0.3] * 10)
    promoted = decide(policy_of(KnowsWhatItWants(push_weight=10.0, p_success=0.7)), heightmap)
    assert isinstance(promoted.primitive, Grasp)
    assert promoted.verdict is not None
    assert promoted.verdict.overruled
    believed = decide(policy_of(KnowsWhatItWants(p_success=0.7)), heightmap)
    assert believed.verdict is not None
    assert not believed.verdict.overruled
    unasked = decide(policy_of(KnowsWhatItWants(p_success=0.3), "tdpg-base"), heightmap)
    assert isinstance(unasked.primitive, Grasp)
    assert unasked.verdict is None


@pytest.mark.parametrize(("push_weight", "expected"), [(1.0, Grasp), (3.0, Push)])
def test_a_push_that_frees_the_goal_comes_before_lifting_what_stands_beside_it(
    push_weight: float, expected: type
) -> None:
    """The goal is too wide to be grasped but at its corners, what stands beside it is not. Red seen
    ahead makes a push worth 0.28 of the weight."""
    heightmap = table_with(
        (70, 70, 60, 60, 0.05),
        (90, 132, 20, 15, 0.05),
        goal=goal_at(slice(70, 130), slice(70, 130)),
    )
    network = KnowsWhatItWants(push_weight=push_weight, p_success=0.9)
    method = dataclasses.replace(METHODS["tdpg-free"], wedged=False)
    policy = LearnedPolicy(network, method, goal=False, dtype=torch.float32)
    assert isinstance(decide(policy, heightmap).primitive, expected)
    assert isinstance(decide(policy_of(network, "tdpg-free"), heightmap).primitive, Grasp)
    assert isinstance(decide(policy_of(network, "tdpg-sure"), heightmap).primitive, Grasp)


def test_critic_two_says_of_any_grasp_what_it_says_when_it_is_asked() -> None:
    heightmap = table_with(*CLUTTER)
    policy = policy_of(trained_light())
    decision = decide(policy, heightmap)
    grasps = best_grasps(decision.maps, np.random.default_rng(0))
    assert decision.verdict is not None
    assert decision.verdict.p_success == tuple(policy.p_success(heightmap, grasps))


def test_the_same_look_gives_the_same_decision_to_the_bit() -> None:
    heightmap = table_with(*CLUTTER)
    for dtype in (torch.float32, torch.bfloat16):
        one, other = (
            LearnedPolicy(trained_light(), METHODS["tdpg"], goal=False, dtype=dtype)
            for _ in range(2)
        )
        first, again, elsewhere = (
            decide(one, heightmap),
            decide(one, heightmap),
            decide(other, heightmap),
        )
        for decision in (again, elsewhere):
            assert decision.primitive == first.primitive
            assert decision.verdict == first.verdict
            assert decision.maps.push.tobytes() == first.maps.push.tobytes()
            assert decision.maps.grasp.tobytes() == first.maps.grasp.tobytes()


def test_deciding_leaves_torch_and_the_given_network_alone() -> None:
    network = trained_light().train()
    threads, seed = torch.get_num_threads(), torch.initial_seed()
    before = {name: value.clone() for name, value in network.state_dict().items()}
    decide(policy_of(network), table_with(*CLUTTER))
    assert network.training
    assert all(parameter.requires_grad for parameter in network.parameters())
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())
    assert torch.get_num_threads() == threads
    assert torch.initial_seed() == seed
    assert torch.is_grad_enabled()


def test_a_refused_action_is_not_proposed_again() -> None:
    heightmap, policy = table_with(*CLUTTER), policy_of(KnowsWhatItWants())
    first = decide(policy, heightmap).primitive
    second = policy.decide(heightmap, np.random.default_rng(0), avoid=[first]).primitive
    turn = abs(np.angle(np.exp(2j * (second.yaw - first.yaw)))) / 2
    distance = np.hypot(second.x - first.x, second.y - first.y)
    assert distance > 0.010 or turn > np.pi / 8 + 1e-9


@pytest.mark.parametrize("method", ["grasp-only", "tdpg"])
def test_an_empty_or_unseen_table_offers_no_action(method: str) -> None:
    policy = policy_of(KnowsWhatItWants(), method)
    unseen = np.full((SIZE, SIZE), np.nan, np.float32)
    for heightmap in (table_with(), dataclasses.replace(table_with(), height=unseen)):
        with pytest.raises(NoActionError, match="no action is allowed"):
            decide(policy, heightmap)


def test_a_goal_policy_needs_a_goal_and_grasps_nothing_else() -> None:
    policy = policy_of(trained_light(goal=True), "grasp-only", goal=True)
    with pytest.raises(HeightmapError, match=r"Heightmap\.goal is None"):
        decide(policy, table_with(*CLUTTER))
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[60:75, 60:75] = True
    decision = decide(policy, table_with(*CLUTTER, goal=goal))
    assert goal[decision.row, decision.col]


def test_absurd_heights_do_not_reach_the_values() -> None:
    heightmap = table_with(*CLUTTER)
    heightmap.height[0, 0] = np.finfo(np.float32).max
    policy = LearnedPolicy(trained_light(), METHODS["vpg"], goal=False, dtype=torch.bfloat16)
    assert np.isfinite(decide(policy, heightmap).q)


def test_encoding_tells_unseen_from_table() -> None:
    heightmap = table_with((10, 10, 20, 20, 0.05))
    heightmap.height[100:, :] = np.nan
    encoded = state.encode(heightmap, goal=False)
    assert encoded.shape == (6, SIZE, SIZE)
    assert encoded[state.INSIDE].min() == 1
    assert encoded[state.SEEN, 50, 50] == 1
    assert encoded[state.SEEN :, 100:].abs().max() == 0
    assert encoded[state.HEIGHT, 15, 15] == pytest.approx(1.0)
    assert encoded[state.RED, 15, 15] == pytest.approx(200 / 255 - 0.5)
