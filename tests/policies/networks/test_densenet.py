from __future__ import annotations

import re

import pytest
import torch
import torch.nn.functional as F

from policies.networks.densenet import DenseNet121

State = dict[str, torch.Tensor]


@pytest.fixture(scope="module")
def tower() -> DenseNet121:
    """In eval mode, with statistics as after some training."""
    torch.manual_seed(0)
    tower = DenseNet121()
    for name, value in tower.state_dict().items():
        if name.endswith(("running_var", "norm.weight")) or re.search(r"norm\d\.weight", name):
            value.uniform_(0.5, 1.5)
        elif name.endswith(("running_mean", "bias")):
            value.uniform_(-0.5, 0.5)
    return tower.eval()


def test_it_is_torchvisions_densenet121(tower: DenseNet121) -> None:
    state = tower.state_dict()
    # torchvision's densenet121 has 7,978,856 parameters, 1,025,000 of them in the classifier.
    assert sum(p.numel() for p in tower.parameters()) == 6_953_856
    assert len(state) == 725
    shapes = {
        "features.conv0.weight": (64, 3, 7, 7),
        "features.norm0.running_mean": (64,),
        "features.denseblock1.denselayer1.norm1.weight": (64,),
        "features.denseblock1.denselayer1.conv1.weight": (128, 64, 1, 1),
        "features.denseblock1.denselayer6.conv1.weight": (128, 224, 1, 1),
        "features.denseblock1.denselayer1.conv2.weight": (32, 128, 3, 3),
        "features.transition1.norm.num_batches_tracked": (),
        "features.transition1.conv.weight": (128, 256, 1, 1),
        "features.denseblock2.denselayer12.norm2.bias": (128,),
        "features.transition2.conv.weight": (256, 512, 1, 1),
        "features.denseblock3.denselayer24.conv1.weight": (128, 992, 1, 1),
        "features.transition3.conv.weight": (512, 1024, 1, 1),
        "features.denseblock4.denselayer16.conv1.weight": (128, 992, 1, 1),
        "features.norm5.weight": (1024,),
    }
    for name, shape in shapes.items():
        assert state[name].shape == shape


def reference(image: torch.Tensor, state: State) -> torch.Tensor:
    """DenseNet-121 from the paper's table 1, on torchvision's names."""

    def norm(x: torch.Tensor, name: str) -> torch.Tensor:
        mean, var, weight, bias = (
            state[f"features.{name}.{part}"][:, None, None]
            for part in ("running_mean", "running_var", "weight", "bias")
        )
        return (x - mean) / (var + 1e-5).sqrt() * weight + bias

    def conv(x: torch.Tensor, name: str, stride: int = 1) -> torch.Tensor:
        weight = state[f"features.{name}.weight"]
        return F.conv2d(x, weight, stride=stride, padding=weight.shape[-1] // 2)

    x = F.max_pool2d(F.relu(norm(conv(image, "conv0", 2), "norm0")), 3, 2, 1)
    for block, layers in enumerate((6, 12, 24, 16), 1):
        for layer in range(1, layers + 1):
            name = f"denseblock{block}.denselayer{layer}"
            y = conv(F.relu(norm(x, f"{name}.norm1")), f"{name}.conv1")
            x = torch.cat((x, conv(F.relu(norm(y, f"{name}.norm2")), f"{name}.conv2")), 1)
        if block < 4:
            x = conv(F.relu(norm(x, f"transition{block}.norm")), f"transition{block}.conv")
            x = F.avg_pool2d(x, 2)
    return norm(x, "norm5")


@torch.no_grad()
def test_it_computes_what_the_paper_says_folded_or_not(tower: DenseNet121) -> None:
    image = torch.randn(1, 3, 64, 96)
    expected = reference(image, tower.state_dict())
    scale = float(expected.abs().max())
    torch.testing.assert_close(tower(image), expected, rtol=1e-4, atol=1e-5 * scale)
    folded = DenseNet121()
    folded.load_state_dict(tower.state_dict())
    folded.eval().fold()
    torch.testing.assert_close(folded(image), expected, rtol=1e-4, atol=1e-5 * scale)
    assert expected.shape == (1, 1024, 2, 3)


@pytest.mark.parametrize("old_names", [False, True])
def test_it_takes_torchvisions_imagenet_weights(tower: DenseNet121, old_names: bool) -> None:
    weights = {
        re.sub(r"(denselayer\d+\.(?:norm|conv))(\d)", r"\1.\2", name) if old_names else name: value
        for name, value in tower.state_dict().items()
    }
    assert ("features.denseblock1.denselayer1.norm.1.weight" in weights) == old_names
    weights |= {"classifier.weight": torch.zeros(1000, 1024), "classifier.bias": torch.zeros(1000)}
    four_channels = DenseNet121(4).eval()
    four_channels.load_imagenet(weights)
    image = torch.randn(1, 3, 32, 32)
    with_goal = torch.cat((image, torch.ones(1, 1, 32, 32)), 1)
    with torch.no_grad():
        torch.testing.assert_close(four_channels(with_goal), tower(image))


def test_weights_of_another_network_are_refused(tower: DenseNet121) -> None:
    weights = tower.state_dict()
    del weights["features.norm5.weight"]
    with pytest.raises(RuntimeError, match=r"norm5\.weight"):
        DenseNet121().load_imagenet(weights)
