"""The way down of a small residual U-Net, and what its layers are made of.

It has no normalisation, and features are zero outside of the workspace at every layer: what stands
in a patch of a picture has the same features as in the whole.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import nn


class Encoder(nn.Module):
    """To stride 8, and back to 4. channels: of the picture. widths: channels at stride 2, 4, 8."""

    def __init__(
        self, channels: int, widths: tuple[int, int, int], *, dilations: Sequence[int]
    ) -> None:
        super().__init__()
        fine, middle, coarse = widths
        # Without bias, what is zero outside stays zero; the channel INSIDE stands in for it.
        self.stem = nn.Conv2d(channels, fine, 6, stride=2, padding=2, bias=False)
        self.down4 = nn.Conv2d(fine, middle, 3, stride=2, padding=1)
        self.mix4 = nn.Conv2d(middle, middle, 3, padding=1)
        self.down8 = nn.Conv2d(middle, coarse, 3, stride=2, padding=1)
        self.blocks = nn.ModuleList(Residual(coarse, dilation) for dilation in dilations)
        self.up4 = nn.Conv2d(coarse, middle, 1, bias=False)

    def begin_as_identity(self) -> None:
        """The blocks; they learn to add something."""
        for block in self.blocks:
            assert isinstance(block, Residual)
            nn.init.zeros_(block.second.weight)

    def encode(self, picture: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """(n, channels, h, w), h and w multiples of 8 -> features at stride 2, and at stride 4
        with what stride 8 knows, and where that is inside."""
        inside4 = picture[:, :1, 2::4, 2::4]  # at the middle of each cell
        inside8 = picture[:, :1, 4::8, 4::8]
        x2 = F.relu_(self.stem(picture))
        x4 = relu_inside(self.down4(x2), inside4)
        x4 = relu_inside(self.mix4(x4), inside4)
        x8 = relu_inside(self.down8(x4), inside8)
        for block in self.blocks:
            x8 = block(x8, inside8)
        x4 = F.relu_(F.interpolate(self.up4(x8), scale_factor=2.0).add_(x4))
        return x2, x4, inside4


class Residual(nn.Module):
    """Two convolutions, the second one dilated, beside the identity."""

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=dilation, dilation=dilation)

    def forward(self, x: torch.Tensor, inside: torch.Tensor) -> torch.Tensor:
        y = relu_inside(self.first(x), inside)
        return relu_inside(self.second(y).add_(x), inside)

    def inner(self, x: torch.Tensor, inside: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What `forward` makes of the middle, which no padding reaches, and `inside` there."""
        y = relu_inside(unpadded(self.first, x), inside[:, :, 1:-1, 1:-1])
        y = unpadded(self.second, y)
        lost = (x.shape[2] - y.shape[2]) // 2
        inside = inside[:, :, lost:-lost, lost:-lost]
        return relu_inside(y.add_(x[:, :, lost:-lost, lost:-lost]), inside), inside


def unpadded(layer: nn.Conv2d, x: torch.Tensor) -> torch.Tensor:
    """The convolution without its padding."""
    return F.conv2d(x, layer.weight, layer.bias, layer.stride, 0, layer.dilation)


def relu_inside(x: torch.Tensor, inside: torch.Tensor) -> torch.Tensor:
    """ReLU, and zero outside. In place, which halves the time of a decision."""
    return F.relu_(x.mul_(inside.to(x.dtype)))  # 0 and 1 are exact; mixed types are slow


def he(module: nn.Module) -> None:
    """He's initialisation of a convolution, for ReLU."""
    if isinstance(module, nn.Conv2d):
        nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
        if module.bias is not None:
            nn.init.zeros_(module.bias)
