"""Epsilon-greedy: what a learning policy does, and what it tells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from policies.decide import Choice, to_primitive
from policies.heightmap import Heightmap
from policies.learned import LearnedPolicy
from policies.policy import Decision
from policies.primitives import Primitive


class Exploring:
    """The policy's decision, or with probability epsilon any allowed action.

    Only actions of the kind that the policy chose from are drawn, each with equal chance.
    """

    def __init__(self, policy: LearnedPolicy, epsilon: float) -> None:
        self._policy = policy
        self._epsilon = epsilon

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        decision = self._policy.decide(heightmap, rng, avoid=avoid)
        if rng.random() >= self._epsilon:
            return decision
        choice = _any_grasp(decision, rng)
        return replace(
            decision,
            primitive=to_primitive(choice, heightmap),
            rotation=choice.rotation,
            row=choice.row,
            col=choice.col,
            q=choice.q,
            verdict=None,
        )


def _any_grasp(decision: Decision, rng: np.random.Generator) -> Choice:
    values = decision.maps.grasp
    allowed = np.flatnonzero(np.isfinite(values))
    place = np.unravel_index(rng.choice(allowed), values.shape)
    rotation, row, col = (int(index) for index in place)
    return Choice(kind="grasp", rotation=rotation, row=row, col=col, q=float(values[place]))
