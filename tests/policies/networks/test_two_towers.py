from __future__ import annotations

import pytest
import torch

from policies import state
from policies.networks.build import for_inference
from policies.networks.two_towers import TwoTowerNet


@pytest.fixture(scope="module")
def network() -> TwoTowerNet:
    torch.manual_seed(0)
    return TwoTowerNet(goal=True)


def a_picture() -> torch.Tensor:
    picture = torch.rand(2, state.channels(goal=True), 64, 64)
    picture[:, state.INSIDE : state.SEEN + 1] = 1
    picture[:, state.RED : state.BLUE + 1] -= 0.5
    return picture


def test_goal_mask_changes_only_the_first_layers(network: TwoTowerNet) -> None:
    with_goal, without = network.state_dict(), TwoTowerNet(goal=False).state_dict()
    assert set(with_goal) == set(without)
    differing = {name for name in without if with_goal[name].shape != without[name].shape}
    assert differing == {
        "color_tower.features.conv0.weight",
        "depth_tower.features.conv0.weight",
    }


@torch.no_grad()
def test_heads_give_one_value_a_cell_and_critic_two_one_a_grasp(network: TwoTowerNet) -> None:
    maps = network.eval()(a_picture())
    assert maps.push.shape == maps.grasp.shape == (2, 1, 2, 2)
    assert maps.features.shape == (2, 2048, 2, 2)
    places = torch.tensor([[-0.5, -0.5], [0.5, 0.5]])
    logits = network.evaluate(maps.features, places)
    assert logits.shape == (2,)
    assert not torch.equal(logits, network.evaluate(maps.features, -places))


@torch.no_grad()
def test_folding_changes_nothing(network: TwoTowerNet) -> None:
    picture = a_picture()
    for _ in range(5):
        network.train()(picture)  # statistics settle on this picture
    expected = network.eval()(picture)
    folded = for_inference(network, torch.float32)(picture)
    torch.testing.assert_close(folded.grasp, expected.grasp, rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(folded.push, expected.push, rtol=1e-3, atol=1e-4)


@torch.no_grad()
def test_towers_see_normalised_colour_and_three_times_depth() -> None:
    network = TwoTowerNet(goal=False)
    picture = torch.zeros(1, state.channels(goal=False), 32, 32)
    picture[:, state.INSIDE] = 1
    picture[:, state.SEEN, 16:] = 1
    picture[:, state.HEIGHT, 16:] = 0.04 * state.HEIGHT_SCALE
    picture[:, state.RED : state.BLUE + 1, 16:] = 0.5  # white
    color, depth = network._images(picture)
    # torchvision: white is (1 - mean) / std, black (0 - mean) / std.
    assert color[0, :, 31, 0].tolist() == pytest.approx([2.2489, 2.4286, 2.64], abs=1e-4)
    assert color[0, :, 0, 0].tolist() == pytest.approx([-2.1179, -2.0357, -1.8044], abs=1e-4)
    # VPG: (d - 0.01) / 0.03; the unseen half is neither table (-0.33) nor block.
    assert depth[0, :, 31, 0].tolist() == pytest.approx([1.0] * 3)
    assert depth[0, :, 0, 0].tolist() == [-1.0] * 3
