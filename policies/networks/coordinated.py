"""The light network, and beside it GI's coordinator, which chooses between its best actions."""

from __future__ import annotations

import torch

from policies.coordinator import Coordinator
from policies.networks.light import LightNet
from policies.networks.maps import Maps, Network


class CoordinatedNet(Network):
    """goal, width: as in LightNet."""

    STRIDE = LightNet.STRIDE
    PATCH = LightNet.PATCH

    def __init__(self, *, goal: bool, width: int = 16) -> None:
        super().__init__()
        self.light = LightNet(goal=goal, width=width)
        self.coordinator = Coordinator()

    def forward(self, picture: torch.Tensor) -> Maps:
        maps: Maps = self.light(picture)
        return maps

    def evaluate(self, features: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        return self.light.evaluate(features, places)
