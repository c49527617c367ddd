"""How PushNet learns from lessons: supervised, every answer being known."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F

from policies.learned import fastest_dtype
from policies.networks.twin import PushNet
from tools.train.pushes.lessons import Lessons

BETAS = (0.9, 0.99)  # paper, section III-D
CLIP = 1.0  # of the gradient's norm
_CHUNK = 128  # questions at a time, where nothing is learnt


class Teacher:
    """Network and optimiser. Randomness comes from the generator that is passed in."""

    def __init__(self, network: PushNet, *, weight_decay: float) -> None:
        self.network = network
        self._optimizer = torch.optim.AdamW(
            network.parameters(), betas=BETAS, weight_decay=weight_decay
        )

    def state(self) -> dict[str, Any]:
        return {"network": self.network.state_dict(), "optimizer": self._optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        self._optimizer.load_state_dict(state["optimizer"])

    def update(
        self, lessons: Lessons, rng: np.random.Generator, *, batch: int, learning_rate: float
    ) -> float:
        """One step on a random batch. Returns the loss: binary cross-entropy with the share that
        was freed."""
        picks = rng.integers(len(lessons), size=batch)
        logits = self._logits(*lessons.questions(picks, rng))
        freed = torch.from_numpy(lessons.freed[picks])
        loss = F.binary_cross_entropy_with_logits(logits, freed)
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate
        self._optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), CLIP)
        self._optimizer.step()
        return loss.item()

    @torch.no_grad()
    def answers(self, lessons: Lessons) -> npt.NDArray[np.float32]:
        """(n,) logits of what each push frees."""
        picks = np.array_split(np.arange(len(lessons)), max(1, len(lessons) // _CHUNK))
        logits = [self._logits(*lessons.questions(some)) for some in picks]
        return torch.cat(logits).numpy()

    def _logits(self, cuts: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        cuts = cuts.contiguous(memory_format=torch.channels_last)
        with torch.autocast("cpu", fastest_dtype(), enabled=fastest_dtype() != torch.float32):
            return self.network.at(cuts, places)
