"""The light network: made for two CPU cores, and for learning from one pixel at a time.

A small residual U-Net, whose value of an action depends on the PATCH of picture around it and on
nothing else: training runs on patches and yields the values of the whole picture.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn

from policies import state
from policies.networks.encoder import Encoder, Residual, he, relu_inside, unpadded
from policies.networks.maps import Maps, Network
from policies.rotation import sample

WINDOW = 5  # cells of 8 mm a side that Critic II looks at


class LightNet(Network, Encoder):
    """PushNet, GraspNet and EvaluationNet on one shared trunk. An action's value depends on
    the 118 pixels (24 cm) around it.

    goal: take the goal mask as a seventh channel. width: channels at stride 2; 16 makes
    0.23 M parameters.
    """

    STRIDE = 8
    PATCH = 144  # pixels; holds the receptive field of every output at every phase

    def __init__(self, *, goal: bool, width: int = 16) -> None:
        fine, middle = width, 2 * width
        super().__init__(state.channels(goal=goal), (fine, middle, 4 * width), dilations=(1, 2))
        self.fuse4 = nn.Conv2d(middle, middle, 3, padding=1)
        self.up2 = nn.Conv2d(middle, fine, 1, bias=False)
        self.fuse2 = nn.Conv2d(fine, 2 * fine, 3, padding=1)
        self.push_net = nn.Conv2d(fine, 1, 1)
        self.grasp_net = nn.Conv2d(fine, 1, 1)
        self.evaluation_net = _EvaluationNet(middle)
        self.apply(he)
        self.begin_as_identity()
        for head in (self.push_net, self.grasp_net):
            nn.init.normal_(head.weight, std=0.01)  # values begin near zero

    def forward(self, picture: torch.Tensor) -> Maps:
        """(n, 6 or 7, h, w), h and w multiples of 8 -> values at stride 2."""
        x2, features, inside4 = self.encode(picture)
        x4 = relu_inside(self.fuse4(features), inside4)
        x2 = F.relu_(F.interpolate(self.up2(x4), scale_factor=2.0).add_(x2))
        push, grasp = F.relu_(self.fuse2(x2)).chunk(2, dim=1)
        return Maps(push=self.push_net(push), grasp=self.grasp_net(grasp), features=features)

    def at(
        self, patches: torch.Tensor, places: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """What `forward` and `evaluate` say of one action a patch, for a third of the work:
        each layer runs only where the next ones need it."""
        inside4 = patches[:, :1, 2::4, 2::4]
        inside8 = patches[:, :1, 4::8, 4::8]
        # Slices name the cells of the whole patch that are left after convolving without padding.
        x2 = F.relu_(unpadded(self.stem, patches[:, :, 4:135, 4:135]))  # 3:66
        x4 = relu_inside(unpadded(self.down4, x2), inside4[:, :, 2:33, 2:33])
        x4 = relu_inside(unpadded(self.mix4, x4), inside4[:, :, 3:32, 3:32])
        x8 = relu_inside(unpadded(self.down8, x4), inside8[:, :, 2:16, 2:16])
        inside8 = inside8[:, :, 2:16, 2:16]
        for block in self.blocks:
            assert isinstance(block, Residual)
            x8, inside8 = block.inner(x8, inside8)  # 4:14, 7:11
        upper8 = F.interpolate(self.up4(x8), scale_factor=2.0)
        features = F.relu_(upper8.add_(x4[:, :, 11:19, 11:19]))  # 14:22
        x4 = relu_inside(unpadded(self.fuse4, features), inside4[:, :, 15:21, 15:21])
        upper4 = F.interpolate(self.up2(x4), scale_factor=2.0)
        x2 = F.relu_(upper4.add_(x2[:, :, 27:39, 27:39]))  # 30:42
        push, grasp = F.relu_(unpadded(self.fuse2, x2)).chunk(2, dim=1)  # 31:41
        near2, near4 = places * (self.PATCH / (10 * 2)), places * (self.PATCH / (8 * 4))
        return (
            sample(self.push_net(push), near2)[:, 0],
            sample(self.grasp_net(grasp), near2)[:, 0],
            self.evaluate(features, near4),
        )

    def evaluate(self, features: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        """Critic II: features (n, c, h, w) and the grasps' places in them (n, 2) in [-1, 1]
        -> (n,) logits of P_success.

        The paper concatenates features and target position; here the target is the centre of
        the window of features, which says the same and holds on patches too.
        """
        cells = torch.arange(WINDOW, device=places.device) - (WINDOW - 1) / 2
        step_x, step_y = 2 / features.shape[3], 2 / features.shape[2]
        rows, cols = torch.meshgrid(cells * step_y, cells * step_x, indexing="ij")
        grid = places[:, None, None, :] + torch.stack((cols, rows), -1)
        window = F.grid_sample(features.float(), grid, align_corners=False)
        logits: torch.Tensor = self.evaluation_net(window.to(features.dtype))
        return logits.float()


class _EvaluationNet(nn.Module):
    """Three 3x3 convolutions and a fully connected layer (paper, section III-D)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.convolutions = nn.ModuleList(
            nn.Conv2d(channels, channels, 3, padding=1) for _ in range(3)
        )
        self.fully_connected = nn.Linear(channels * WINDOW**2, 1)

    def forward(self, window: torch.Tensor) -> torch.Tensor:
        for convolution in self.convolutions:
            window = F.relu(convolution(window))
        logits: torch.Tensor = self.fully_connected(window.flatten(1))
        return logits[:, 0]
