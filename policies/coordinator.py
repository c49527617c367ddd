"""GI's coordinator: a classifier that tells whether the goal's best grasp would succeed now, or a
push has to come first (Yang, Liang and Choi, "A Deep Learning Approach to Grasping the Invisible",
2020)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from policies.border import border_norm, border_occupancy
from policies.heightmap import Heightmap
from policies.policy import Choice
from policies.primitives import Grasp, Primitive

SITUATION = 5
PUSH, GRASP = range(2)  # its classes


class Coordinator(nn.Sequential):
    """Situations (n, 5) -> logits of its classes (n, 2)."""

    def __init__(self) -> None:
        super().__init__(
            nn.Linear(SITUATION, 16), nn.ReLU(), nn.Linear(16, 8), nn.ReLU(), nn.Linear(8, 2)
        )


def situation(
    grasp: Choice, push: Choice, heightmap: Heightmap, avoid: Sequence[Primitive]
) -> npt.NDArray[np.float32]:
    """(5,): the values of the best push and of the goal's best grasp, the occupancy and the norm
    of the goal's border, and how many grasps are to be avoided, for they failed or were refused."""
    failures = sum(isinstance(primitive, Grasp) for primitive in avoid)
    return np.array(
        [push.q, grasp.q, border_occupancy(heightmap), border_norm(heightmap), failures],
        np.float32,
    )


def coordinated(
    coordinator: Coordinator,
    grasps: Sequence[Choice],
    push: Choice | None,
    heightmap: Heightmap,
    avoid: Sequence[Primitive],
) -> Choice | None:
    """The goal's best grasp, if its success is the likelier class, or the best push. Where one of
    them is not allowed it is the other; where neither is, the best of the other grasps."""
    grasp = on_goal(grasps, heightmap)
    if grasp is None or push is None:
        return grasp or push or next(iter(grasps), None)
    weight = next(coordinator.parameters())
    seen = torch.from_numpy(situation(grasp, push, heightmap, avoid)).to(weight.dtype)
    return grasp if coordinator(seen[None])[0].argmax() == GRASP else push


def on_goal(grasps: Sequence[Choice], heightmap: Heightmap) -> Choice | None:
    """The first of them that is on the goal; the first of all, where there is no goal."""
    goal = heightmap.goal
    return next((each for each in grasps if goal is None or goal[each.row, each.col]), None)
