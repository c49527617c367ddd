"""Critic I values every action; Critic II doubts the best grasps (paper, section III)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch

from policies.networks.maps import Maps, Network
from policies.policy import HALF_TURN, ROTATIONS, Choice, QMaps
from policies.rotation import back_to_map, pictures, positions


def critic_one(
    network: Network, state: torch.Tensor, *, pushes: bool
) -> tuple[QMaps, torch.Tensor]:
    """Q(s, a) = (phi_p(s), phi_g(s)) of all actions, in one batch; nothing is masked yet.

    A grasp looks the same from both sides. When pushes are valued all sixteen pictures are
    made, and a grasp takes the mean of its two views; else eight pictures do.
    state: (C, 224, 224). Returns the maps, and the features that Critic II reads.
    """
    maps: Maps = network(pictures(state, ROTATIONS if pushes else HALF_TURN))
    if not pushes:
        grasp = back_to_map(maps.grasp.float())[:, 0].numpy()
        push = np.full((ROTATIONS, *grasp.shape[1:]), -np.inf, np.float32)
    else:
        push = back_to_map(maps.push.float())[:, 0].numpy()
        both = back_to_map(maps.grasp.float())[:, 0]
        grasp = both.view(2, HALF_TURN, *both.shape[1:]).mean(0).numpy()
    return QMaps(push=push, grasp=np.concatenate((grasp, grasp))), maps.features


def critic_two(
    network: Network, features: torch.Tensor, grasps: Sequence[Choice]
) -> npt.NDArray[np.float64]:
    """P_success of each grasp (paper, eq. 2), from both sides where both pictures were made."""
    rotations, rows, cols = (
        torch.tensor([getattr(grasp, name) for grasp in grasps])
        for name in ("rotation", "row", "col")
    )
    sides = range(0, len(features), HALF_TURN)
    logits = [
        network.evaluate(features[side], positions(side, rows, cols))
        for side in (rotations % HALF_TURN + turned for turned in sides)
    ]
    return torch.sigmoid(torch.stack(logits).double().mean(0)).numpy()
