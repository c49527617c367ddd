"""What every network returns, and what `critics` asks of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import torch
from torch import nn

from policies.rotation import sample


class Maps(NamedTuple):
    """Of a batch of pictures. push, grasp: (n, 1, h, w) action values at the network's stride;
    features: (n, c, h', w') what Critic II reads."""

    push: torch.Tensor
    grasp: torch.Tensor
    features: torch.Tensor


class Network(nn.Module, ABC):
    """PushNet, GraspNet (Critic I) and EvaluationNet (Critic II) on shared features.

    STRIDE: pixels of a picture to the coarsest features. PATCH: pixels a side of what it learns
    an action's value from.
    """

    STRIDE: ClassVar[int]
    PATCH: ClassVar[int]

    @abstractmethod
    def forward(self, picture: torch.Tensor) -> Maps:
        """Turned states (n, 6 or 7, h, w) -> values of both actions, and features."""

    @abstractmethod
    def evaluate(self, features: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        """Features (n, c, h', w') and grasps' places in them (n, 2) in [-1, 1] -> (n,) logits
        of P_success."""

    def at(
        self, patches: torch.Tensor, places: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Patches (n, 6 or 7, PATCH, PATCH), one around each action at places (n, 2), which are no
        more than STRIDE / 2 pixels from the middle -> Q_push, Q_grasp and the logit of P_success,
        (n,) each."""
        maps: Maps = self(patches)
        return (
            sample(maps.push, places)[:, 0],
            sample(maps.grasp, places)[:, 0],
            self.evaluate(maps.features, places),
        )

    def fold(self) -> None:
        """Rewrite eval-mode computations into fewer, where there are any."""
