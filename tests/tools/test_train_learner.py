from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
import torch

from policies.heightmap import SIZE, Heightmap, Workspace
from policies.learned import LearnedPolicy
from policies.methods import METHODS
from policies.networks.build import build
from policies.networks.light import LightNet
from policies.rotation import patches, sample
from policies.state import encode
from tools.train.config import Learning
from tools.train.learner import Learner, augmented
from tools.train.replay import CANDIDATES, TRANSITION, Replay, pack_goal, pack_height


def cube_at(row: int, col: int) -> Heightmap:
    height = np.zeros((SIZE, SIZE), np.float32)
    height[row - 12 : row + 13, col - 12 : col + 13] = 0.05
    return Heightmap(
        workspace=Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15),
        color=np.full((SIZE, SIZE, 3), 128, np.uint8),
        height=height,
    )


def replay_of_cubes(directory: Path, count: int) -> Replay:
    """Grasps on the cube's middle succeed, grasps on its rim fail."""
    rng = np.random.default_rng(0)
    replay = Replay(directory, count)
    heights, colors = [], []
    transitions = np.zeros(count, TRANSITION)
    for i in range(count):
        row, col = rng.integers(40, SIZE - 40, 2)
        heightmap = cube_at(int(row), int(col))
        good = i % 2 == 0
        heights.append(pack_height(heightmap.height))
        colors.append(heightmap.color)
        transitions[i]["look"], transitions[i]["next_look"] = i, -1
        transitions[i]["row"], transitions[i]["col"] = row, col + (0 if good else 11)
        transitions[i]["reward"] = transitions[i]["grasped"] = good
    replay.extend(np.array(heights), np.array(colors), transitions)
    return replay


@pytest.mark.slow
def test_it_learns_where_to_grasp_a_cube(tmp_path: Path) -> None:
    torch.manual_seed(0)
    replay = replay_of_cubes(tmp_path, 32)
    learner = Learner(
        LightNet(goal=False, width=8), Learning(learning_rate=3e-3, discount=0.0, batch=8)
    )
    rng = np.random.default_rng(0)
    first = learner.update(replay, rng, importance=1.0)
    for _ in range(40):
        last = learner.update(replay, rng, importance=1.0)
    assert last["huber"] < first["huber"] / 3

    policy = LearnedPolicy(learner.network, METHODS["grasp-only"], goal=False, dtype=torch.float32)
    decision = policy.decide(cube_at(90, 130), rng)
    assert np.hypot(decision.row - 90, decision.col - 130) < 8  # px; the rim is at 12


def test_the_target_is_reward_plus_discounted_best_grasp_of_what_follows(tmp_path: Path) -> None:
    """Paper, eq. 1, against whole Q-maps of the next state."""
    torch.manual_seed(1)
    network = LightNet(goal=False, width=8)
    torch.nn.init.normal_(network.grasp_net.weight)  # values that differ from place to place
    following = cube_at(100, 100)
    grasps = [(k, 96 + k, 104 - k) for k in range(8)] + [(0, 100, 100), (3, 90, 95)]
    replay = Replay(tmp_path, 2)
    transition = np.zeros(1, TRANSITION)
    transition["look"], transition["next_look"] = 0, 1
    transition["next_grasps"] = np.array(grasps)[None]
    assert len(grasps) == CANDIDATES
    before = cube_at(60, 60)
    replay.extend(
        np.stack([pack_height(before.height), pack_height(following.height)]),
        np.stack([before.color, following.color]),
        transition,
    )
    learner = Learner(network, Learning(discount=0.5))
    value = learner.value_of_next(replay, replay.transitions[:1])

    from policies.rotation import back_to_map, pictures

    with torch.no_grad():
        q = back_to_map(network(pictures(encode(following, goal=False))).grasp)[:, 0]
    assert value.item() == pytest.approx(max(q[k, r, c].item() for k, r, c in grasps), abs=1e-4)


def test_vpg_looks_ahead_to_pushes_too(tmp_path: Path) -> None:
    network = LightNet(goal=False, width=8)
    assert network.push_net.bias is not None
    torch.nn.init.constant_(network.push_net.bias, 5.0)
    look = cube_at(100, 100)
    transitions = np.zeros(2, TRANSITION)
    transitions["next_grasps"] = [0, 100, 100]
    transitions["next_push"] = [(3, 60, 100), (-1, -1, -1)]
    replay = Replay(tmp_path, 2)
    replay.extend(pack_height(look.height)[None], look.color[None], transitions)
    for next_action, pushes_count in (("grasp", False), ("either", True)):
        learner = Learner(network, Learning.model_validate({"next_action": next_action}))
        with_push, without = learner.value_of_next(replay, replay.transitions[:2]).tolist()
        assert (with_push > 3.0) == pushes_count
        assert without < 1.0


@pytest.mark.slow
def test_the_paper_s_network_learns_by_the_same_lines(tmp_path: Path) -> None:
    torch.manual_seed(0)
    replay = replay_of_cubes(tmp_path, 4)
    network = build("densenet121", goal=False, width=32)
    before = copy.deepcopy(network.state_dict())
    learner = Learner(network, Learning(discount=0.0, batch=2))
    learner.update(replay, np.random.default_rng(0), importance=1.0)
    learnt = {
        name.split(".")[0]
        for name, weight in network.state_dict().items()
        if not torch.equal(weight, before[name])
    }
    assert learnt == {"color_tower", "depth_tower", "push_net", "grasp_net", "evaluation_net"}


def test_nothing_follows_the_end_of_a_trial(tmp_path: Path) -> None:
    replay = replay_of_cubes(tmp_path, 2)
    learner = Learner(LightNet(goal=False, width=8), Learning(discount=0.5))
    assert not learner.value_of_next(replay, replay.transitions[:2]).any()


def test_critic_two_learns_only_where_it_is_switched_on(tmp_path: Path) -> None:
    """Ablation: TDPG-base has Critic I alone."""
    for critic_two in (True, False):
        torch.manual_seed(0)
        network = LightNet(goal=False, width=8)
        before = network.evaluation_net.fully_connected.weight.detach().clone()
        replay = replay_of_cubes(tmp_path / str(critic_two), 4)
        learning = Learning(batch=4, weight_decay=0.0)
        learner = Learner(network, learning, critic_two=critic_two)
        learner.update(replay, np.random.default_rng(0), importance=1.0)
        after = network.evaluation_net.fully_connected.weight
        assert torch.equal(after, before) != critic_two


def test_a_push_teaches_push_net_and_no_other_head(tmp_path: Path) -> None:
    replay = replay_of_cubes(tmp_path, 4)
    replay.transitions["push"], replay.transitions["grasped"] = True, -1
    network = LightNet(goal=False, width=8)
    before = copy.deepcopy(network)
    Learner(network, Learning(batch=4, weight_decay=0.0)).update(
        replay, np.random.default_rng(0), importance=1.0
    )
    assert not torch.equal(network.push_net.weight, before.push_net.weight)
    assert torch.equal(network.grasp_net.weight, before.grasp_net.weight)


def test_the_goal_is_seen_while_learning(tmp_path: Path) -> None:
    """The same look with another goal has another value."""
    torch.manual_seed(2)
    network = LightNet(goal=True, width=8)
    torch.nn.init.normal_(network.grasp_net.weight)
    replay = Replay(tmp_path, 2, goal=True)
    look = cube_at(100, 100)
    goals = np.zeros((2, SIZE, SIZE), np.bool_)
    goals[0, 90:110, 90:110] = True
    transitions = np.zeros(2, TRANSITION)
    transitions["look"], transitions["next_look"] = [0, 1], [0, 1]
    transitions["next_grasps"] = [0, 100, 100]
    replay.extend(
        np.stack([pack_height(look.height)] * 2),
        np.stack([look.color] * 2),
        transitions,
        np.stack([pack_goal(goal) for goal in goals]),
    )
    learner = Learner(network, Learning())
    with_goal, without = learner.value_of_next(replay, replay.transitions[:2]).tolist()
    assert abs(with_goal - without) > 1e-3


def test_symmetries_move_picture_and_place_together() -> None:
    """The pixel that is marked is still the one at the place."""
    rng = np.random.default_rng(2)
    count = 64
    states = torch.zeros(count, 6, SIZE, SIZE)
    rows, cols = (torch.from_numpy(rng.integers(60, SIZE - 60, count)) for _ in range(2))
    states[torch.arange(count), 2, rows, cols] = 1.0
    rotations = torch.from_numpy(rng.integers(0, 16, count))
    cuts, places = patches(states, rotations, rows, cols, size=144, stride=8)
    push = rng.random(count) < 0.5
    moved, moved_places = augmented(cuts.clone(), places, push, rng)
    torch.testing.assert_close(sample(moved, moved_places)[:, 2], sample(cuts, places)[:, 2])
    turned = (moved_places[:, 1] != places[:, 1]).numpy()
    assert not turned[push].any()  # a push points up, and stays so
    assert turned[~push].any()


def test_colours_change_places_and_nothing_else() -> None:
    cuts = torch.zeros(32, 6, 8, 8)
    cuts[:, 3:6] = torch.tensor([1.0, 2.0, 3.0])[:, None, None]
    moved, _ = augmented(
        cuts.clone(), torch.zeros(32, 2), np.ones(32, np.bool_), np.random.default_rng(0)
    )
    assert not moved[:, :3].any()
    assert {tuple(pixel.tolist()) for pixel in moved[:, 3:6, 0, 0]} > {(1.0, 2.0, 3.0)}
    torch.testing.assert_close(moved[:, 3:6].sum(1), cuts[:, 3:6].sum(1))
