from __future__ import annotations

import pytest
import torch
from torch import nn

from policies.heightmap import SIZE
from policies.networks.light import LightNet
from policies.policy import ROTATIONS
from policies.rotation import back_to_map, patches, pictures, positions, sample


@pytest.fixture(params=[False, True], ids=["agnostic", "goal"])
def network(request: pytest.FixtureRequest) -> LightNet:
    torch.manual_seed(0)
    network = LightNet(goal=request.param)
    for parameter in network.parameters():  # also what begins at zero takes part
        nn.init.normal_(parameter, std=0.1)
    return network


def random_state(network: LightNet) -> torch.Tensor:
    state = torch.rand(network.stem.in_channels, SIZE, SIZE)
    state[0] = 1
    return state


@torch.no_grad()
def test_a_patch_yields_the_value_of_the_whole_picture(network: LightNet) -> None:
    state = random_state(network)
    whole = network(pictures(state))
    k = torch.randint(ROTATIONS, (48,))
    rows, cols = torch.randint(SIZE, (2, 48))
    rows[:8], cols[:8] = torch.tensor([0, 0, 223, 223] * 2), torch.tensor([0, 223] * 4)
    k[:8] = torch.tensor([2, 2, 2, 2, 6, 6, 7, 9])  # corners, which come nearest to the border
    cuts, places = patches(
        state.expand(48, -1, -1, -1), k, rows, cols, size=LightNet.PATCH, stride=LightNet.STRIDE
    )
    cut = network(cuts)

    for name in ("push", "grasp"):
        expected = back_to_map(getattr(whole, name))[k, 0, rows, cols]
        value = sample(getattr(cut, name), places)[:, 0]
        assert expected.std() > 1e-3
        torch.testing.assert_close(value, expected, rtol=1e-4, atol=1e-4 * float(expected.std()))

    expected = network.evaluate(whole.features[k], positions(k, rows, cols))
    logits = network.evaluate(cut.features, places)
    assert expected.std() > 1e-4
    torch.testing.assert_close(logits, expected, rtol=1e-4, atol=1e-4 * float(expected.std()))


def test_one_action_is_valued_as_the_whole_patch_values_it(network: LightNet) -> None:
    """At the border of where a place may be, on patches that the workspace's border crosses."""
    patches = torch.rand(8, network.stem.in_channels, LightNet.PATCH, LightNet.PATCH)
    patches[:, 0] = 1
    patches[4:, :, :60], patches[6:, :, :, 90:] = 0, 0
    far = LightNet.STRIDE / LightNet.PATCH
    places = torch.tensor([[-far, -far], [far, far], [-far, far], [0.02, -0.01]]).repeat(2, 1)

    maps = network(patches)
    logits = network.evaluate(maps.features, places)
    expected = sample(maps.push, places)[:, 0], sample(maps.grasp, places)[:, 0], logits
    actual = network.at(patches, places)
    for value, reference in zip(actual, expected, strict=True):
        torch.testing.assert_close(
            value, reference, rtol=1e-4, atol=1e-4 * float(reference.detach().std())
        )

    def gradients(values: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
        return torch.autograd.grad(torch.cat(values).square().sum(), list(network.parameters()))

    for gradient, reference in zip(gradients(actual), gradients(expected), strict=True):
        scale = float(reference.abs().max())
        torch.testing.assert_close(gradient, reference, rtol=1e-3, atol=1e-4 * scale)


def test_the_receptive_field_holds_a_push_and_fits_into_a_patch(network: LightNet) -> None:
    picture = torch.rand(1, network.stem.in_channels, 320, 320)
    picture[:, 0] = 1
    picture.requires_grad_()
    (gradient,) = torch.autograd.grad(network(picture).push[0, 0, 80, 80], picture)
    rows = gradient[0].abs().sum((0, 2)).nonzero()
    assert 100 <= rows.max() - rows.min() + 1 <= LightNet.PATCH  # 200 mm or more


def test_it_is_light() -> None:
    assert sum(p.numel() for p in LightNet(goal=True).parameters()) < 250_000


def test_training_and_inference_compute_the_same(network: LightNet) -> None:
    picture = pictures(random_state(network), 2)
    torch.testing.assert_close(network.train()(picture).grasp, network.eval()(picture).grasp)


def test_outside_of_the_workspace_features_are_zero(network: LightNet) -> None:
    whole = network(pictures(random_state(network)))
    assert whole.features[0, :, :11].abs().max() == 0
    assert whole.features[0, :, 40].abs().max() > 0
