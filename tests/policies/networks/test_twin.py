from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from policies import state
from policies.heightmap import PIXEL, SIZE
from policies.networks.twin import AHEAD, PushNet, TwinNet, all_that_rises
from policies.primitives import PUSH_LENGTH
from policies.rotation import back_to_map, patches, pictures, sample
from policies.standing import RISE


@pytest.fixture(params=[False, True], ids=["agnostic", "goal"])
def network(request: pytest.FixtureRequest) -> TwinNet:
    torch.manual_seed(0)
    network = TwinNet(goal=request.param)
    for parameter in network.push_net.parameters():  # also what begins at zero takes part
        nn.init.normal_(parameter, std=0.06)
    return network


@pytest.fixture
def shown(network: TwinNet) -> torch.Tensor:
    """A random state, as this network takes it."""
    shown = torch.rand(state.channels(goal=network.goal), SIZE, SIZE)
    shown[0] = 1
    return shown


@torch.no_grad()
def test_grasps_are_those_of_the_light_network(network: TwinNet, shown: torch.Tensor) -> None:
    """Whatever the goal is."""
    picture = pictures(shown, 2)
    twin, light = network(picture), network.light(picture[:, : state.GOAL])
    torch.testing.assert_close(twin.grasp, light.grasp, rtol=0, atol=0)
    torch.testing.assert_close(twin.features, light.features, rtol=0, atol=0)


@torch.no_grad()
def test_a_push_has_the_value_at_the_middle_of_its_way(
    network: TwinNet, shown: torch.Tensor
) -> None:
    """The value of the whole picture is PushNet's own, asked on a patch around a place AHEAD."""
    whole = back_to_map(network(pictures(shown)).push)
    rotations = torch.tensor([0, 3, 6, 11])
    rows, cols = torch.tensor([120, 100, 90, 60]), torch.tensor([60, 110, 150, 100])
    yaw = rotations * np.pi / 8
    aimed = shown if len(shown) == 7 else torch.cat((shown, all_that_rises(shown[None])[0]))
    cuts, places = patches(
        aimed.expand(4, -1, -1, -1),
        rotations,
        rows - AHEAD * torch.cos(yaw),
        cols - AHEAD * torch.sin(yaw),
        size=PushNet.PATCH,
        stride=PushNet.STRIDE,
    )
    values = torch.sigmoid(network.push_net.at(cuts, places))
    expected = whole[rotations, 0, rows, cols]
    assert expected.std() > 1e-3
    torch.testing.assert_close(values, expected, rtol=1e-3, atol=1e-3)


def test_the_middle_is_half_of_a_push_ahead() -> None:
    assert abs(AHEAD * PIXEL - PUSH_LENGTH / 2) <= 0.002


def test_the_receptive_field_holds_all_of_a_push_and_fits_into_a_patch(network: TwinNet) -> None:
    picture = torch.rand(1, 7, 320, 320)
    picture[:, 0] = 1
    picture.requires_grad_()
    (gradient,) = torch.autograd.grad(network.push_net(picture)[0, 0, 40, 40], picture)
    rows = gradient[0].abs().sum((0, 2)).nonzero()
    across = int(rows.max() - rows.min()) + 1
    assert PUSH_LENGTH / PIXEL + 2 * 0.05 / PIXEL <= across <= PushNet.PATCH


def test_without_a_goal_all_that_rises_is_to_be_freed() -> None:
    picture = torch.zeros(1, 6, SIZE, SIZE)
    picture[0, state.HEIGHT, 50:70, 60:90] = 3 * RISE * state.HEIGHT_SCALE
    picture[0, state.HEIGHT, 150:160] = RISE / 2 * state.HEIGHT_SCALE
    shown = all_that_rises(picture)
    assert shown.shape == (1, 1, SIZE, SIZE)
    assert shown.sum() == shown[0, 0, 50:70, 60:90].sum() == 600


def test_one_push_is_valued_as_the_whole_patch_values_it(network: TwinNet) -> None:
    """At the border of where a place may be, on patches that the workspace's border crosses."""
    patches = torch.rand(8, 7, PushNet.PATCH, PushNet.PATCH)
    patches[:, 0] = 1
    patches[4:, :, :80], patches[6:, :, :, 110:] = 0, 0
    far = PushNet.STRIDE / PushNet.PATCH
    places = torch.tensor([[-far, -far], [far, far], [-far, far], [0.02, -0.01]]).repeat(2, 1)
    expected = sample(network.push_net(patches), places)[:, 0]
    actual = network.push_net.at(patches, places)
    assert expected.std() > 1e-4
    torch.testing.assert_close(actual, expected, rtol=1e-4, atol=1e-7)

    def gradients(values: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return torch.autograd.grad(values.square().sum(), list(network.push_net.parameters()))

    for gradient, reference in zip(gradients(actual), gradients(expected), strict=True):
        scale = float(reference.abs().max())
        torch.testing.assert_close(gradient, reference, rtol=1e-3, atol=1e-4 * scale)


@torch.no_grad()
def test_one_action_is_valued_as_the_whole_patch_values_it(
    network: TwinNet, shown: torch.Tensor
) -> None:
    """What `Network.at` says holds for patches that are cut around a push's start."""
    rotations, rows, cols = torch.tensor([2]), torch.tensor([110]), torch.tensor([120])
    cuts, places = patches(
        shown[None], rotations, rows, cols, size=TwinNet.PATCH, stride=TwinNet.STRIDE
    )
    push, grasp, _ = network.at(cuts, places)
    maps = network(pictures(shown))
    for value, picture in ((push, maps.push), (grasp, maps.grasp)):
        expected = back_to_map(picture)[2, 0, 110, 120]
        torch.testing.assert_close(value[0], expected, rtol=1e-3, atol=1e-4)


def test_the_same_weights_clear_and_fetch() -> None:
    clears, fetches = TwinNet(goal=False), TwinNet(goal=True)
    fetches.load_state_dict(clears.state_dict())
    picture = torch.rand(1, 6, 64, 64)
    everything = torch.cat((picture, all_that_rises(picture)), 1)
    for ours, theirs in zip(clears(picture), fetches(everything), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=0)


def test_it_is_small_enough_to_ship() -> None:
    size = sum(p.numel() * p.element_size() for p in TwinNet(goal=True).parameters())
    assert size < 15e6 / 4  # bytes; a shipped policy has 15 MB at most
