"""Networks by name, and their frozen form."""

from __future__ import annotations

import copy

import torch
from torch import nn

from policies.networks.light import LightNet
from policies.networks.maps import Network

KINDS = ("light",)


def build(kind: str, *, goal: bool, width: int) -> Network:
    """A network with fresh weights. kind: one of KINDS. width: channels at stride 2 (light)."""
    if kind == "light":
        return LightNet(goal=goal, width=width)
    raise ValueError(f"network kind {kind!r} is unknown; known are {', '.join(KINDS)}")


def for_inference(network: Network, dtype: torch.dtype) -> Network:
    """A frozen copy: eval mode, no gradients, channels last."""
    frozen = copy.deepcopy(network).eval().requires_grad_(False).to(dtype)
    for module in frozen.modules():
        if isinstance(module, nn.Conv2d):
            module.weight.data = module.weight.contiguous(memory_format=torch.channels_last)
    return frozen
