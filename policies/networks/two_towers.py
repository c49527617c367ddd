"""The paper's network around its DenseNets: towers for colour and depth, and three heads."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import nn

from policies import state
from policies.networks.densenet import FEATURES, DenseNet121, fold_pair
from policies.networks.maps import Maps, Network
from policies.rotation import sample

# torchvision's ImageNet statistics of red, green, blue; VPG's of depth (m).
_RGB_MEAN, _RGB_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_DEPTH_MEAN, _DEPTH_STD = 0.01, 0.03
_UNSEEN = -1.0  # normalised depth; the table is at -0.33
_CHUNK = 4  # pictures at a time through both towers: more leave the caches


class TwoTowerNet(Network):
    """Two DenseNet-121, whose features PushNet, GraspNet and EvaluationNet share.

    goal: give both towers' first layer one more channel for the goal mask, "the sole
    difference of the network's structure" (paper, section III-D).
    """

    STRIDE = 32
    # It looks further than a picture, and learns from all that is seen within 32 cm of an action,
    # wherever in the picture it decides on that lies.
    PATCH = 320

    def __init__(self, *, goal: bool) -> None:
        super().__init__()
        self.goal = goal
        self.color_tower = DenseNet121(3 + goal)
        self.depth_tower = DenseNet121(3 + goal)
        self.push_net = _pixel_head(2 * FEATURES)
        self.grasp_net = _pixel_head(2 * FEATURES)
        self.evaluation_net = _EvaluationNet(2 * FEATURES)
        self.rgb_mean: torch.Tensor
        self.rgb_std: torch.Tensor
        self.register_buffer("rgb_mean", _per_channel(_RGB_MEAN), persistent=False)
        self.register_buffer("rgb_std", _per_channel(_RGB_STD), persistent=False)

    def forward(self, picture: torch.Tensor) -> Maps:
        """(n, 6 or 7, h, w), h and w multiples of 32 -> values at stride 32."""
        features = self._features(picture)
        return Maps(push=self.push_net(features), grasp=self.grasp_net(features), features=features)

    def evaluate(self, features: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        logits: torch.Tensor = self.evaluation_net(features, places)
        return logits

    def load_imagenet(self, weights: Mapping[str, torch.Tensor]) -> None:
        """Begin both towers with torchvision's densenet121 state dict."""
        self.color_tower.load_imagenet(weights)
        self.depth_tower.load_imagenet(weights)

    def fold(self) -> None:
        """Put normalisations into the convolutions before them. Eval mode only."""
        self.color_tower.fold()
        self.depth_tower.fold()
        for head in (self.push_net, self.grasp_net):
            fold_pair(head, "conv0", "norm1")

    def _features(self, picture: torch.Tensor) -> torch.Tensor:
        color, depth = self._images(picture)
        if self.training:
            return torch.cat((self.color_tower(color), self.depth_tower(depth)), 1)
        chunks = zip(torch.split(color, _CHUNK), torch.split(depth, _CHUNK), strict=True)
        return torch.cat(
            [torch.cat((self.color_tower(c), self.depth_tower(d)), 1) for c, d in chunks]
        )

    def _images(self, picture: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What the towers expect: normalised colour, and normalised depth three times."""
        seen = picture[:, state.SEEN : state.SEEN + 1]
        rgb = picture[:, state.RED : state.BLUE + 1] + 0.5 * seen  # black where unseen
        color = (rgb - self.rgb_mean) / self.rgb_std
        height = picture[:, state.HEIGHT : state.HEIGHT + 1] / state.HEIGHT_SCALE
        depth = torch.where(seen > 0, (height - _DEPTH_MEAN) / _DEPTH_STD, _UNSEEN)
        depth = depth.expand(-1, 3, -1, -1)
        if self.goal:
            goal = picture[:, state.GOAL : state.GOAL + 1]
            color, depth = torch.cat((color, goal), 1), torch.cat((depth, goal), 1)
        return (
            color.contiguous(memory_format=torch.channels_last),
            depth.contiguous(memory_format=torch.channels_last),
        )


def _pixel_head(channels: int) -> nn.Sequential:
    """Two 1x1 convolutions with batch normalisation and ReLU (VPG's head)."""
    return nn.Sequential(
        OrderedDict(
            norm0=nn.BatchNorm2d(channels),
            relu0=nn.ReLU(),
            conv0=nn.Conv2d(channels, 64, 1, bias=False),
            norm1=nn.BatchNorm2d(64),
            relu1=nn.ReLU(inplace=True),
            conv1=nn.Conv2d(64, 1, 1),
        )
    )


class _EvaluationNet(nn.Module):
    """Features, concatenated with the position that GraspNet chose, through three 3x3
    convolutions and a fully connected layer (paper, sections III-B and III-D)."""

    def __init__(self, channels: int, hidden: int = 64) -> None:
        super().__init__()
        widths = (channels + 1, hidden, hidden)
        self.convolutions = nn.ModuleList(nn.Conv2d(n, hidden, 3, padding=1) for n in widths)
        self.fully_connected = nn.Linear(hidden, 1)

    def forward(self, features: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        x = torch.cat((features, _position_map(places, features)), 1)
        for convolution in self.convolutions:
            x = F.relu(convolution(x))
        logits: torch.Tensor = self.fully_connected(sample(x.float(), places).to(x.dtype))
        return logits[:, 0].float()


def _position_map(places: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
    """(n, 1, h, w): one at each place, shared by its four neighbours as in interpolation."""
    _, _, height, width = features.shape
    x = (places[:, 0] + 1) * width / 2 - 0.5
    y = (places[:, 1] + 1) * height / 2 - 0.5
    across = (1 - (torch.arange(width) - x[:, None]).abs()).clamp(min=0)
    down = (1 - (torch.arange(height) - y[:, None]).abs()).clamp(min=0)
    return (down[:, None, :, None] * across[:, None, None, :]).to(features.dtype)


def _per_channel(values: tuple[float, float, float]) -> torch.Tensor:
    return torch.tensor(values)[None, :, None, None]
