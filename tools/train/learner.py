"""What is learnt from a batch of experience (paper, sections III-A and III-D)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F

from policies.heightmap import Heightmap, Workspace
from policies.networks.maps import Network
from policies.rotation import patches
from policies.state import BLUE, RED, encode
from tools.train.config import Learning
from tools.train.replay import Replay, unpack_goal, unpack_height


class Learner:
    """Network and optimiser. Randomness comes from the generator that is passed in.

    critic_two: whether EvaluationNet learns too.
    """

    def __init__(self, network: Network, learning: Learning, *, critic_two: bool = True) -> None:
        self.network = network
        self._learning = learning
        self._critic_two = critic_two
        self._optimizer = torch.optim.Adam(
            network.parameters(),
            lr=learning.learning_rate,
            betas=learning.betas,
            weight_decay=learning.weight_decay,
        )

    def state(self) -> dict[str, Any]:
        return {"network": self.network.state_dict(), "optimizer": self._optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        self._optimizer.load_state_dict(state["optimizer"])

    def set_learning_rate(self, rate: float) -> None:
        for group in self._optimizer.param_groups:
            group["lr"] = rate

    def update(
        self, replay: Replay, rng: np.random.Generator, *, importance: float
    ) -> dict[str, float]:
        """One step on one prioritized batch. Returns the losses."""
        learning = self._learning
        picks, weights = replay.sample(
            learning.batch, rng, exponent=learning.priority_exponent, importance=importance
        )
        batch = replay.transitions[picks]
        target = torch.from_numpy(batch["reward"].copy())
        if learning.discount:
            target = target + learning.discount * self.value_of_next(replay, batch)

        states = _states(replay, batch["look"])
        cuts, places = patches(
            states,
            torch.from_numpy(batch["rotation"].astype(np.int64)),
            torch.from_numpy(batch["row"].astype(np.int64)),
            torch.from_numpy(batch["col"].astype(np.int64)),
            size=self.network.PATCH,
            stride=self.network.STRIDE,
        )
        cuts, places = augmented(cuts, places, batch["push"], rng)
        cuts = cuts.contiguous(memory_format=torch.channels_last)
        push, grasp, logits = self.network.at(cuts, places)
        q = torch.where(torch.from_numpy(batch["push"].copy()), push, grasp)
        loss = critic_one = (
            torch.from_numpy(weights) * F.huber_loss(q, target, reduction="none")
        ).mean()

        critic_two = _doubt(logits, batch["grasped"])
        if self._critic_two:
            loss = loss + critic_two

        self._optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        self._optimizer.step()
        error = (q - target).detach()
        replay.reprioritize(picks, error.numpy())
        return {
            "huber": critic_one.item(),
            "bce": critic_two.item(),
            "td_error": error.abs().mean().item(),
        }

    @torch.no_grad()
    def value_of_next(self, replay: Replay, batch: npt.NDArray[np.void]) -> torch.Tensor:
        """max Q_grasp(s', a') over the grasps that were best when s' was seen (paper, eq. 1), and
        Q_push of the push that was where pushes count too (VPG): the stored label is refreshed
        with today's weights."""
        value = torch.zeros(len(batch))
        going_on = np.flatnonzero(batch["next_look"] >= 0)
        if going_on.size == 0:
            return value
        following = batch[going_on]
        best = following["next_grasps"][:, : self._learning.next_grasps]
        if self._learning.next_action == "either":
            best = np.concatenate((best, following["next_push"][:, None]), 1)
        actions = best.astype(np.int64)
        count = actions.shape[1]
        states = _states(replay, following["next_look"])
        cuts, places = patches(
            [state for state in states for _ in range(count)],
            *(torch.from_numpy(actions[..., i].reshape(-1)) for i in range(3)),
            size=self.network.PATCH,
            stride=self.network.STRIDE,
        )
        push, grasp, _ = self.network.at(cuts, places)
        q = grasp.view(-1, count)
        if self._learning.next_action == "either":
            possible = torch.from_numpy(following["next_push"][:, 0] >= 0)
            q[:, -1] = torch.where(possible, push.view(-1, count)[:, -1], -torch.inf)
        value[torch.from_numpy(going_on)] = q.amax(1)
        return value


# A state does not say where the workspace lies.
_ANYWHERE = Workspace(x_min=0.0, y_min=0.0, table_z=0.0)


def _states(replay: Replay, looks: npt.NDArray[np.int32]) -> torch.Tensor:
    """(n, C, 224, 224) of stored looks."""
    heightmaps = (
        Heightmap(
            workspace=_ANYWHERE,
            color=np.asarray(replay.colors[look]),
            height=unpack_height(replay.heights[look]),
            goal=None if replay.goals is None else unpack_goal(replay.goals[look]),
        )
        for look in looks
    )
    goal = replay.goals is not None
    return torch.stack([encode(heightmap, goal=goal) for heightmap in heightmaps])


def _doubt(logits: torch.Tensor, grasped: npt.NDArray[np.int8]) -> torch.Tensor:
    """Binary cross-entropy of Critic II over the grasps of a batch (paper, section III-D).
    grasped: 1, 0, or -1 where no grasp was tried."""
    tried = torch.from_numpy(grasped >= 0)
    label = torch.from_numpy(grasped.astype(np.float32)).clamp(min=0)
    each = F.binary_cross_entropy_with_logits(logits, label, reduction="none")
    return (each * tried).sum() / tried.sum().clamp(min=1)


def augmented(
    cuts: torch.Tensor,
    places: torch.Tensor,
    push: npt.NDArray[np.bool_],
    rng: np.random.Generator,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Patches (n, C, h, w) and places (n, 2) under the symmetries of the task.

    Gripper and table have no left and right, so half of the patches are mirrored about the
    action's direction. A grasp turned by half a turn is the same grasp. Colours mean nothing
    to a block: their channels change places.
    """
    count = len(cuts)
    mirror = torch.from_numpy(rng.random(count) < 0.5)
    turn = torch.from_numpy((rng.random(count) < 0.5) & ~push)
    cuts = torch.where(mirror[:, None, None, None], cuts.flip(3), cuts)
    cuts = torch.where(turn[:, None, None, None], cuts.flip(2, 3), cuts)
    signs = torch.ones_like(places)
    signs[mirror, 0] *= -1
    signs[turn] *= -1
    channels = RED + rng.permuted(np.tile(np.arange(3), (count, 1)), axis=1)
    cuts[:, RED : BLUE + 1] = cuts[torch.arange(count)[:, None], torch.from_numpy(channels)]
    return cuts, places * signs
