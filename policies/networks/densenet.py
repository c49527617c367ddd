"""The paper's network: two DenseNet-121 towers that PushNet, GraspNet and EvaluationNet share.

DenseNet-121 as in Huang et al., "Densely Connected Convolutional Networks" (CVPR 2017), with
torchvision's parameter names, so that its ImageNet weights load unchanged.
"""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

GROWTH = 32
BLOCKS = (6, 12, 24, 16)
FEATURES = 1024


class _DenseLayer(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm1 = nn.BatchNorm2d(channels)
        self.conv1 = nn.Conv2d(channels, 4 * GROWTH, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(4 * GROWTH)
        self.conv2 = nn.Conv2d(4 * GROWTH, GROWTH, 3, padding=1, bias=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        bottleneck = self.conv1(F.relu_(self.norm1(x)))
        new = self.conv2(F.relu_(self.norm2(bottleneck)))
        return torch.cat((x, new), 1)


def fold_pair(module: nn.Module, convolution: str, norm: str) -> None:
    """Put the batch normalisation that follows a convolution into its weights. Eval mode only."""
    conv, bn = module.get_submodule(convolution), module.get_submodule(norm)
    assert isinstance(conv, nn.Conv2d)
    assert isinstance(bn, nn.BatchNorm2d)
    setattr(module, convolution, fuse_conv_bn_eval(conv, bn))
    setattr(module, norm, nn.Identity())


def _transition(channels: int) -> nn.Sequential:
    return nn.Sequential(
        OrderedDict(
            norm=nn.BatchNorm2d(channels),
            relu=nn.ReLU(inplace=True),
            conv=nn.Conv2d(channels, channels // 2, 1, bias=False),
            pool=nn.AvgPool2d(2),
        )
    )


class DenseNet121(nn.Module):
    """(n, in_channels, h, w) -> (n, 1024, h / 32, w / 32), the features before the classifier."""

    def __init__(self, in_channels: int = 3) -> None:
        super().__init__()
        self.in_channels = in_channels
        self.features = nn.Sequential()
        self.features.add_module(
            "conv0", nn.Conv2d(in_channels, 64, 7, stride=2, padding=3, bias=False)
        )
        self.features.add_module("norm0", nn.BatchNorm2d(64))
        self.features.add_module("relu0", nn.ReLU(inplace=True))
        self.features.add_module("pool0", nn.MaxPool2d(3, stride=2, padding=1))
        channels = 64
        for number, layers in enumerate(BLOCKS, 1):
            block = nn.Sequential()
            for layer in range(1, layers + 1):
                block.add_module(f"denselayer{layer}", _DenseLayer(channels))
                channels += GROWTH
            self.features.add_module(f"denseblock{number}", block)
            if number < len(BLOCKS):
                self.features.add_module(f"transition{number}", _transition(channels))
                channels //= 2
        self.features.add_module("norm5", nn.BatchNorm2d(channels))
        assert channels == FEATURES
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        features: torch.Tensor = self.features(image)
        return features

    def fold(self) -> None:
        """Put each normalisation that follows a convolution into it. Eval mode only."""
        fold_pair(self.features, "conv0", "norm0")
        for module in self.modules():
            if isinstance(module, _DenseLayer):
                fold_pair(module, "conv1", "norm2")

    def load_imagenet(self, weights: Mapping[str, torch.Tensor]) -> None:
        """Take a state dict of torchvision's densenet121, old names ("norm.1") or new.

        More input channels than three start at zero, so the goal mask changes nothing yet.
        """
        own = {
            re.sub(r"\.(norm|conv)\.(\d)\.", r".\1\2.", name): value.clone()
            for name, value in weights.items()
            if not name.startswith("classifier.")
        }
        first = own["features.conv0.weight"]
        missing = self.in_channels - first.shape[1]
        own["features.conv0.weight"] = F.pad(first, (0, 0, 0, 0, 0, missing))
        self.load_state_dict(own)
