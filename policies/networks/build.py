"""Networks by name, and their frozen form."""

from __future__ import annotations

import copy

import torch
from torch import nn

from policies.networks.coordinated import CoordinatedNet
from policies.networks.densenet import GROWTH
from policies.networks.light import LightNet
from policies.networks.maps import Network
from policies.networks.twin import TwinNet
from policies.networks.two_towers import TwoTowerNet

# What `width` may be: channels of the light network at stride 2, DenseNet's growth rate.
WIDTHS = {
    "light": range(4, 65),
    "twin": range(4, 65),
    "coordinated": range(4, 65),
    "densenet121": range(GROWTH, GROWTH + 1),
}
# Weights of first layers, whose last input channel is the goal mask where there is one.
ENTRANCES = {
    "light": ("stem.weight",),
    "twin": (),  # its weights do not depend on it
    "coordinated": ("light.stem.weight",),
    "densenet121": tuple(
        f"{tower}.features.conv0.weight" for tower in ("color_tower", "depth_tower")
    ),
}


def build(kind: str, *, goal: bool, width: int) -> Network:
    """A network with fresh weights; kind and width as in WIDTHS."""
    if kind not in WIDTHS:
        raise ValueError(f"network {kind!r} is unknown; known are {', '.join(WIDTHS)}")
    if width not in WIDTHS[kind]:
        widths = WIDTHS[kind]
        raise ValueError(f"width = {width} is not within {widths[0]} to {widths[-1]} for {kind}")
    if kind == "densenet121":
        return TwoTowerNet(goal=goal)
    if kind == "coordinated":
        return CoordinatedNet(goal=goal, width=width)
    return {"light": LightNet, "twin": TwinNet}[kind](goal=goal, width=width)


def for_inference(network: Network, dtype: torch.dtype) -> Network:
    """A frozen copy: eval mode, no gradients, folded, channels last."""
    frozen = copy.deepcopy(network).eval().requires_grad_(False)
    frozen.fold()
    frozen = frozen.to(dtype)
    for module in frozen.modules():
        if isinstance(module, nn.Conv2d):
            module.weight.data = module.weight.contiguous(memory_format=torch.channels_last)
    return frozen
