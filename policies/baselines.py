"""Policies without a network, to compare with."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from policies.decide import best_grasps, best_push, choose_by_critic_one, decided
from policies.errors import NoActionError
from policies.heightmap import SIZE, Heightmap
from policies.masks import allowed
from policies.policy import ROTATIONS, Decision, QMaps
from policies.primitives import Primitive


class RandomPolicy:
    """Any allowed grasp, all equally likely; with `pushes`, every other action is any push."""

    def __init__(self, *, pushes: bool = False) -> None:
        self.pushes = pushes

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        start = time.perf_counter()
        shape = (ROTATIONS, SIZE, SIZE)
        push_now = self.pushes and rng.random() < 0.5
        maps = QMaps(
            grasp=np.zeros(shape, np.float32),
            push=np.full(shape, 1 if push_now else -np.inf, np.float32),
        )
        maps = allowed(maps, heightmap, avoid)
        grasps = best_grasps(maps, rng, goal=heightmap.goal, count=1)
        chosen = choose_by_critic_one(grasps, best_push(maps, rng))
        if chosen is None:
            raise NoActionError(f"random: no action is allowed ({len(avoid)} are to be avoided)")
        return decided(chosen, heightmap, maps, seconds={"choose": time.perf_counter() - start})
