"""TDPG and its predecessors as configurations of the same parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from policies.border import border_occupancy
from policies.decide import (
    CONSIDERED,
    choose_by_critic_one,
    choose_by_critic_two,
    choose_if_sure,
    choose_surest,
)
from policies.heightmap import Heightmap
from policies.policy import Choice

Rule = Callable[[Sequence[Choice], Choice | None, Heightmap], Choice | None]
Judge = Callable[[Choice, Sequence[Choice], Choice | None, npt.NDArray[np.float64]], Choice]


@dataclass(frozen=True, kw_only=True)
class Method:
    """choose: the best grasps, the best push and what was seen -> one of them; None if there
    is none. No rule: the network's coordinator chooses. pushes: both maps are valued. judge: what
    Critic II makes of that choice, of the same grasps and push, and of each grasp's P_success;
    None: it has no say. judge_for_goal: in its stead when a goal is to be fetched, if it differs.
    considered: how many grasps all are shown; with a goal, as many on it and as many of what is in
    its way. sure_first: of each, as many that surely hold what they close on, and after them as
    many of the others. promising: of pushes only the most promising kind is considered. wedged: of
    grasps those too that may squeeze out what they close on.
    push_from: the value from which on a push is made for a goal before anything is lifted that is
    in its way. foreseen: grasps of a goal and pushes for it are tried in simulation before one is
    made, so many pushes at most, by whoever runs the policy in a cell."""

    name: str
    choose: Rule | None
    pushes: bool = True
    judge: Judge | None = None
    judge_for_goal: Judge | None = None
    considered: int = CONSIDERED
    sure_first: bool = False
    promising: bool = True
    wedged: bool = False
    push_from: float = np.inf
    foreseen: int = 0

    def judge_of(self, heightmap: Heightmap) -> Judge | None:
        if heightmap.goal is None or self.judge_for_goal is None:
            return self.judge
        return self.judge_for_goal


def highest_value(
    grasps: Sequence[Choice], push: Choice | None, _heightmap: Heightmap
) -> Choice | None:
    """VPG's and TDPG's Critic I."""
    return choose_by_critic_one(grasps, push)


OCCUPIED = 0.3  # EPG: part of the goal's border above which it is pushed free first
WORTHWHILE = 1.0  # EPG: grasp value below which it pushes, in units of the grasp's reward


def free_the_goal(
    grasps: Sequence[Choice], push: Choice | None, heightmap: Heightmap
) -> Choice | None:
    """EPG: push while the goal is hemmed in, or no grasp promises its reward."""
    if not grasps or push is None:
        return choose_by_critic_one(grasps, push)
    hemmed_in = border_occupancy(heightmap) > OCCUPIED
    return push if hemmed_in or grasps[0].q < WORTHWHILE else grasps[0]


SURE = 0.6  # P_success from which on a grasp is made: more fail below, more is pushed for above
SURE_OF_GOAL = 0.8  # and with a goal: what lies in a heap fails more often than Critic II believes
FREES = 0.6  # share of pushes like it that free a goal, from which on one is made at once
FEW = 3  # grasps: the one of many that looks best is the one that Critic II is most wrong about
# And where Critic II was taught by grasps that it was not sure of:
SURE_WHEN_TAUGHT = 0.84
SURE_OF_GOAL_WHEN_TAUGHT = 0.9
SURE_OF_GOAL_WHEN_FORESEEN = 0.96  # of 33 grasps that were given .9 to this, 12 failed
MORE = 6

# At decision time VPG and TDPG-base (Critic I alone) differ in nothing but their training.
METHODS = {
    method.name: method
    for method in (
        Method(name="grasp-only", choose=highest_value, pushes=False),
        Method(name="vpg", choose=highest_value),
        Method(name="vpg+critic", choose=highest_value, judge=choose_by_critic_two),
        Method(name="gi", choose=None),
        Method(name="epg", choose=free_the_goal),
        Method(name="tdpg-base", choose=highest_value),
        Method(name="tdpg", choose=highest_value, judge=choose_by_critic_two),
        Method(
            name="tdpg-sure",
            choose=highest_value,
            judge=partial(choose_if_sure, least=SURE),
            judge_for_goal=partial(choose_if_sure, least=SURE_OF_GOAL),
            considered=FEW,
            sure_first=True,
        ),
    )
}
METHODS["tdpg-free"] = replace(
    METHODS["tdpg-sure"],
    name="tdpg-free",
    judge=partial(choose_surest, least=SURE_WHEN_TAUGHT),
    judge_for_goal=partial(choose_if_sure, least=SURE_OF_GOAL_WHEN_TAUGHT),
    considered=MORE,
    promising=False,
    wedged=True,
    push_from=FREES,
)
METHODS["tdpg-foreseen"] = replace(
    METHODS["tdpg-free"],
    name="tdpg-foreseen",
    judge_for_goal=partial(choose_if_sure, least=SURE_OF_GOAL_WHEN_FORESEEN),
    foreseen=128,
)
