"""The light network, and beside it a PushNet of its own that looks along a push's whole way.

What a grasp is worth shows within a gripper's reach. What a push frees depends on all that it
sets in motion: so its value is read from the features around the middle of its way, which know
166 pixels (33 cm), and learning it leaves grasps as they are. It is always asked to free something:
a goal, or all that stands on the table. What a grasp is worth depends on no goal: so the same
weights clear tables and fetch what they are told to.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn

from policies import state
from policies.heightmap import PIXEL
from policies.networks.encoder import Encoder, Residual, he, relu_inside, unpadded
from policies.networks.light import LightNet
from policies.networks.maps import Maps, Network
from policies.primitives import PUSH_LENGTH
from policies.rotation import sample
from policies.standing import RISE

_STRIDE = 4  # pixels of the picture to one of PushNet's values
_CELLS = round(PUSH_LENGTH / 2 / PIXEL / _STRIDE)
AHEAD = _CELLS * _STRIDE  # pixels from a push's start to the middle of its way
_WIDTHS = (32, 64, 96)  # channels at stride 2, 4, 8
_DILATIONS = (1, 2, 2)


class TwinNet(Network):
    """goal: take the goal mask as a seventh channel, which only pushes are asked about; weights of
    one are weights of the other. width: as in LightNet."""

    STRIDE = 8
    PATCH = 256  # pixels; holds what a push's value depends on, around its start

    def __init__(self, *, goal: bool, width: int = 16) -> None:
        super().__init__()
        self.light = LightNet(goal=False, width=width)
        self.push_net = PushNet()
        self.goal = goal

    def forward(self, picture: torch.Tensor) -> Maps:
        """(n, 6 or 7, h, w), h and w multiples of 8 -> values at stride 4 of pushes, 2 of grasps.
        A push is worth the share of what is asked for that it frees: 0 to 1."""
        aimed = picture if self.goal else torch.cat((picture, all_that_rises(picture)), 1)
        maps = self.light(picture[:, : state.GOAL])
        return Maps(push=self.push_net.values(aimed), grasp=maps.grasp, features=maps.features)

    def evaluate(self, features: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        return self.light.evaluate(features, places)


def all_that_rises(picture: torch.Tensor) -> torch.Tensor:
    """(n, 6, h, w) -> (n, 1, h, w): what stands above the table, as a goal's channel has it."""
    height = picture[:, state.HEIGHT : state.HEIGHT + 1]
    return (height > RISE * state.HEIGHT_SCALE).to(picture.dtype)


class PushNet(Encoder):
    """Logits of what pushes free of the goal's channel, each at the middle of its way:
    (n, 7, h, w) -> (n, 1, h / 4, w / 4). Zero outside of the workspace at every layer, as LightNet.
    """

    STRIDE = 8
    PATCH = 192  # pixels; holds the receptive field of every output at every phase

    def __init__(self) -> None:
        super().__init__(state.channels(goal=True), _WIDTHS, dilations=_DILATIONS)
        middle = _WIDTHS[1]
        self.fuse4 = nn.Conv2d(middle, middle, 3, padding=1)
        self.value = nn.Conv2d(middle, 1, 1)
        self.apply(he)
        self.begin_as_identity()
        nn.init.normal_(self.value.weight, std=0.01)

    def forward(self, picture: torch.Tensor) -> torch.Tensor:
        _, x4, inside4 = self.encode(picture)
        logits: torch.Tensor = self.value(relu_inside(self.fuse4(x4), inside4))
        return logits

    def values(self, picture: torch.Tensor) -> torch.Tensor:
        """(n, 1, h / 4, w / 4) shares that are freed, 0 to 1, each at the push's start."""
        at_middle = torch.sigmoid(self(picture))
        return F.pad(at_middle, (0, 0, _CELLS, 0))[:, :, :-_CELLS]  # the way leads upwards

    def at(self, patches: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        """What `forward` says of one push a patch (n, 7, PATCH, PATCH), for half of the work: each
        layer runs only where the next ones need it. places: (n, 2) the middles of the pushes'
        ways, no more than STRIDE / 2 pixels from the patches'. Logits (n,)."""
        inside4 = patches[:, :1, 2::4, 2::4]
        inside8 = patches[:, :1, 4::8, 4::8]
        # Slices name the cells of the whole patch that are left after convolving without padding.
        x2 = F.relu_(unpadded(self.stem, patches[:, :, 4:182, 4:182]))  # 3:90
        x4 = relu_inside(unpadded(self.down4, x2), inside4[:, :, 2:45, 2:45])
        x4 = relu_inside(unpadded(self.mix4, x4), inside4[:, :, 3:44, 3:44])
        x8, inside8 = unpadded(self.down8, x4), inside8[:, :, 2:22, 2:22]
        x8 = relu_inside(x8, inside8)
        for block in self.blocks:
            assert isinstance(block, Residual)
            x8, inside8 = block.inner(x8, inside8)  # 4:20, 7:17, 10:14
        upper8 = F.interpolate(self.up4(x8), scale_factor=2.0)[:, :, 1:7, 1:7]
        x4 = F.relu_(upper8.add(x4[:, :, 18:24, 18:24]))  # 21:27
        x4 = relu_inside(unpadded(self.fuse4, x4), inside4[:, :, 22:26, 22:26])
        near = places * (self.PATCH / (4 * _STRIDE))
        return sample(self.value(x4).float(), near)[:, 0]
