"""What every network returns, and what `critics` asks of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import nn


class Maps(NamedTuple):
    """Of a batch of pictures. push, grasp: (n, 1, h, w) action values at the network's stride;
    features: (n, c, h', w') what Critic II reads."""

    push: torch.Tensor
    grasp: torch.Tensor
    features: torch.Tensor


class Network(nn.Module, ABC):
    """PushNet, GraspNet (Critic I) and EvaluationNet (Critic II) on shared features."""

    @abstractmethod
    def forward(self, picture: torch.Tensor) -> Maps:
        """Turned states (n, 6 or 7, h, w) -> values of both actions, and features."""

    @abstractmethod
    def evaluate(self, features: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        """Features (n, c, h', w') and grasps' places in them (n, 2) in [-1, 1] -> (n,) logits
        of P_success."""

    def fold(self) -> None:
        """Rewrite eval-mode computations into fewer, where there are any."""
