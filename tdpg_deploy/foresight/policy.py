"""A policy whose pushes for a goal are tried in simulation before one is made."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TypeAlias

import numpy as np

from policies.decide import Choice, best_apart, decided, to_primitive
from policies.heightmap import Heightmap
from policies.learned import LearnedPolicy
from policies.masks import strike_out
from policies.policy import Decider, Decision
from policies.primitives import Primitive, Push
from policies.standing import Map
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.foresight.imagined import grasps_after

# Sure grasps of the goal after each push, one push after the other; nothing where no goal is seen.
Foresee: TypeAlias = Callable[[Heightmap, Sequence[Push]], Iterator[int]]

# Of 155 pushes after which simulation found 300 or more, 154 freed the goal (training tables that
# PushNet had not learnt from).
PLENTY = 300
BY_VALUE = 16  # pushes that are tried before others at random


def with_foresight(policy: Decider, config: CellConfig) -> Decider:
    """The policy itself, unless its method asks for foresight."""
    if isinstance(policy, LearnedPolicy) and policy.method.foreseen:
        foresee = partial(grasps_after, config=config)
        return ForeseeingPolicy(policy, foresee, pushes=policy.method.foreseen)
    return policy


class ForeseeingPolicy:
    """Where the policy would push for a goal, this makes the push after which simulation finds most
    sure grasps of the goal, or the first after which it finds PLENTY. Where it finds none after
    any, the policy's own."""

    def __init__(self, policy: Decider, foresee: Foresee, *, pushes: int) -> None:
        """pushes: so many are tried at most, of those that are valued most and of all others."""
        self._policy = policy
        self._foresee = foresee
        self._pushes = pushes

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        decision = self._policy.decide(heightmap, rng, avoid=avoid)
        if heightmap.goal is None or not isinstance(decision.primitive, Push):
            return decision
        start = time.perf_counter()
        chosen, grasps = self._best_foreseen(decision.maps.push, heightmap, rng)
        return decided(
            chosen,
            heightmap,
            decision.maps,
            verdict=decision.verdict,
            seconds={**decision.seconds, "foresight": time.perf_counter() - start},
            foreseen=grasps,
        )

    def _best_foreseen(
        self, values: Map, heightmap: Heightmap, rng: np.random.Generator
    ) -> tuple[Choice, int]:
        choices = _to_try(values, rng, self._pushes)
        pushes = [to_primitive(choice, heightmap) for choice in choices]
        after = self._foresee(heightmap, [push for push in pushes if isinstance(push, Push)])
        chosen, most = choices[0], 0
        for choice, grasps in zip(choices, after, strict=False):
            if grasps > most:
                chosen, most = choice, grasps
            if most >= PLENTY:
                break
        return chosen, most


def _to_try(values: Map, rng: np.random.Generator, count: int) -> list[Choice]:
    """The pushes that are valued most, then any that are allowed; no two near each other."""
    most_valued = list(islice(best_apart(values, "push", rng), min(count, BY_VALUE)))
    equal = np.where(np.isneginf(values), values, np.float32(0))
    for choice in most_valued:
        strike_out(equal, choice.rotation, choice.row, choice.col)
    others = islice(best_apart(equal, "push", rng), count - len(most_valued))
    return most_valued + [
        replace(other, q=float(values[other.rotation, other.row, other.col])) for other in others
    ]
