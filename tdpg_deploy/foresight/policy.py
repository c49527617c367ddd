"""A policy whose actions for a goal are tried in simulation before one is made."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TypeAlias

import numpy as np

from policies.decide import best_apart, decided, to_primitive
from policies.heightmap import Heightmap
from policies.learned import LearnedPolicy
from policies.masks import strike_out
from policies.policy import Choice, Decider, Decision
from policies.primitives import Grasp, Primitive, Push
from policies.standing import Map
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.foresight.imagined import WORLDS, Imagined, ImaginedTable

Imagine: TypeAlias = Callable[[Heightmap], Imagined | None]

# On tables of thirty, all 122 grasps to which Critic II gave .96 or more and which simulation saw
# take their object took it. Of those that it saw fail, 40 of 45 from .985 on took it, and fewer
# below; of those from .8 to .96 that it saw take it, 12 of 15.
TRUSTED = 0.985  # P_success from which on a grasp of the goal is made whatever simulation says
DOUBTFUL = 0.8  # and from which on if simulation sees it take the goal
# In the cases' first looks (56, eight of the nine) all 10 grasps that took the goal in all worlds
# took it, to which Critic II gave .2 to .8; on tables of thirty 3 of 5 from .5 to .8.
UNLIKELY = 0.3  # and if it takes it in all simulated worlds
# After pushes in a simulated crate the next grasp took the goal in 1 of 6 cases where it had 10 to
# 20 sure grasps, in 1 of 2 from 40 to 70, in 18 of 22 from 70 to 120. On training tables pushes had
# freed it in 70 of 84 cases where 100 to 300 were foreseen, and in 154 of 155 from there on.
# So of a goal with c sure grasps (pixels and rotations), 1 - exp(-c / FREE) are taken to be free.
FREE = 60
ENOUGH = 0.95  # how likely a push has to free the goal, that no other is tried
SOME = 10  # in the likeliest world, from which on others are tried
BY_VALUE = 16  # pushes that are tried before others at random


def with_foresight(policy: Decider, config: CellConfig) -> Decider:
    """The policy itself, unless its method asks for foresight."""
    if isinstance(policy, LearnedPolicy) and policy.method.foreseen:
        imagine = partial(ImaginedTable.of, config=config)
        return ForeseeingPolicy(policy, imagine, pushes=policy.method.foreseen)
    return policy


class ForeseeingPolicy:
    """For a goal this makes the most promising grasp that takes it in simulation, too; or the most
    promising anyway, if Critic II can be trusted on it; else the push that most likely frees it.
    What the policy chose is made where it is to lift what is in the way, and where simulation
    finds nothing that is of use."""

    def __init__(self, policy: Decider, imagine: Imagine, *, pushes: int) -> None:
        """pushes: so many are tried at most, of those that are valued most and of all others."""
        self._policy = policy
        self._imagine = imagine
        self._pushes = pushes

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        decision = self._policy.decide(heightmap, rng, avoid=avoid)
        if heightmap.goal is None:
            return decision
        start = time.perf_counter()
        decision = self._foreseen(decision, heightmap, rng)
        seconds = {**decision.seconds, "foresight": time.perf_counter() - start}
        return replace(decision, seconds=seconds)

    def _foreseen(
        self, decision: Decision, heightmap: Heightmap, rng: np.random.Generator
    ) -> Decision:
        imagined = self._imagine(heightmap)
        if imagined is None:
            return decision
        grasps = _grasps_of_goal(decision, heightmap)
        for grasp, p in grasps:
            primitive = to_primitive(grasp, heightmap)
            assert isinstance(primitive, Grasp)
            worlds = 1 if p >= DOUBTFUL else WORLDS
            if p >= UNLIKELY and all(islice(imagined.takes_goal(primitive), worlds)):
                return _instead(decision, grasp, heightmap, p_foreseen=1.0)
        if grasps and grasps[0][1] >= TRUSTED:
            return _instead(decision, grasps[0][0], heightmap, p_foreseen=0.0)
        if isinstance(decision.primitive, Grasp) and not _grasps_goal(decision, heightmap):
            return decision
        push, p_foreseen = self._best_push(decision.maps.push, heightmap, imagined, rng)
        if push is None:
            return replace(decision, p_foreseen=0.0)
        return _instead(decision, push, heightmap, p_foreseen=p_foreseen)

    def _best_push(
        self,
        values: Map,
        heightmap: Heightmap,
        imagined: Imagined,
        rng: np.random.Generator,
    ) -> tuple[Choice | None, float]:
        """None where all that are tried come to nothing."""
        chosen, best = None, 0.0
        for choice in _to_try(values, rng, self._pushes):
            push = to_primitive(choice, heightmap)
            assert isinstance(push, Push)
            frees = _p_free(imagined.grasps_after(push), best)
            if frees > best:
                chosen, best = choice, frees
            if best >= ENOUGH:
                break
        return chosen, best


def _p_free(grasps: Iterator[int], best: float) -> float:
    """How likely it is that the goal is free, by its sure grasps in one world after the other. Less
    than that where the first has but few, and 0 where it is no more than `best` anyway."""
    p = 1.0
    for number, count in enumerate(grasps):
        held_fast = np.exp(-count / FREE)
        p -= held_fast / WORLDS
        if p <= best:
            return 0.0
        if number == 0 and count < SOME:
            return float(1 - held_fast) / WORLDS
    return float(p)


def _grasps_of_goal(decision: Decision, heightmap: Heightmap) -> list[tuple[Choice, float]]:
    """Those that were considered, and what Critic II gives them. The most promising first: those
    that it can be trusted on, the nearer to the goal's middle the better, for there it hangs
    straight; then the others, the surest first."""
    goal, verdict = heightmap.goal, decision.verdict
    if goal is None or verdict is None:
        return []
    both = zip(decision.considered, verdict.p_success, strict=True)
    middle = np.argwhere(goal).mean(axis=0)

    def doubt(each: tuple[Choice, float]) -> tuple[bool, float]:
        grasp, p = each
        if p < TRUSTED:
            return True, -p
        return False, float(np.hypot(*(middle - (grasp.row, grasp.col))))

    return sorted(((grasp, p) for grasp, p in both if goal[grasp.row, grasp.col]), key=doubt)


def _grasps_goal(decision: Decision, heightmap: Heightmap) -> bool:
    return heightmap.goal is not None and bool(heightmap.goal[decision.row, decision.col])


def _instead(
    decision: Decision, choice: Choice, heightmap: Heightmap, *, p_foreseen: float | None = None
) -> Decision:
    """The same decision, but to do this."""
    return decided(
        choice,
        heightmap,
        decision.maps,
        verdict=decision.verdict,
        considered=decision.considered,
        seconds=decision.seconds,
        p_foreseen=p_foreseen,
    )


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
