"""Epsilon-greedy: what a learning policy does, and what it tells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from policies.decide import best_grasps, best_push, decided
from policies.errors import NoActionError
from policies.heightmap import Heightmap
from policies.policy import Choice, Decider, Decision, QMaps
from policies.primitives import Primitive
from tools.train.config import StageKind

Kind = Literal["grasp", "push"]


class Exploring:
    """What the stage asks for: the policy's choice, the best action of one kind, or with
    probability epsilon any action that is allowed.

    An explored action is of a random kind, and any of that kind with equal chance. What follows
    a push validates it, so nothing is explored there; in the push stage it is the best grasp.
    """

    def __init__(
        self, policy: Decider, stage: StageKind, epsilon: float, *, prepared: Callable[[], bool]
    ) -> None:
        """prepared: whether the next action validates the one before."""
        self._policy = policy
        self._stage = stage
        self._epsilon = epsilon
        self._prepared = prepared

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        decision = self._policy.decide(heightmap, rng, avoid=avoid)
        validating = self._prepared()
        kinds = _kinds(self._stage, validating)
        if not validating and rng.random() < self._epsilon:
            choice = any_action(decision.maps, kinds, rng)
        elif kinds == ("grasp",):
            choice = _best_grasp(decision.maps, heightmap, rng)
        elif kinds == ("push",):
            choice = best_push(decision.maps, rng)
        else:
            return decision
        if choice is None:
            raise NoActionError(f"no {' or '.join(kinds)} is allowed: nothing is left to learn")
        return with_choice(decision, choice, heightmap)


def with_choice(decision: Decision, choice: Choice, heightmap: Heightmap) -> Decision:
    """The decision, but for what is done: nobody was asked about it."""
    return decided(choice, heightmap, decision.maps, seconds=decision.seconds)


def _best_grasp(maps: QMaps, heightmap: Heightmap, rng: np.random.Generator) -> Choice | None:
    """On the goal, if there is one and a grasp on it is allowed."""
    return next(iter(best_grasps(maps, rng, goal=heightmap.goal, count=1)), None)


def any_action(maps: QMaps, kinds: Sequence[Kind], rng: np.random.Generator) -> Choice | None:
    """Of a random kind among those with allowed actions, any with equal chance."""
    allowed = {kind: np.flatnonzero(np.isfinite(_values(maps, kind))) for kind in kinds}
    possible = [kind for kind in kinds if allowed[kind].size]
    if not possible:
        return None
    kind = possible[rng.integers(len(possible))]
    values = _values(maps, kind)
    place = np.unravel_index(rng.choice(allowed[kind]), values.shape)
    rotation, row, col = (int(index) for index in place)
    return Choice(kind=kind, rotation=rotation, row=row, col=col, q=float(values[place]))


def _kinds(stage: StageKind, validating: bool) -> tuple[Kind, ...]:
    if stage == "synergy":
        return ("grasp", "push")
    return ("push",) if stage == "push" and not validating else ("grasp",)


def _values(maps: QMaps, kind: Kind) -> npt.NDArray[np.float32]:
    return maps.grasp if kind == "grasp" else maps.push
