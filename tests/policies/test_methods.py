from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from tables import table_with

from policies.decide import choose_by_critic_two
from policies.heightmap import SIZE
from policies.methods import METHODS
from policies.policy import Choice

GRASP = Choice(kind="grasp", rotation=0, row=0, col=0, q=1.2)
PUSH = Choice(kind="push", rotation=0, row=0, col=0, q=1.5)


def test_the_papers_methods_exist() -> None:
    assert {"vpg", "gi", "epg", "tdpg-base", "tdpg"} <= set(METHODS)
    assert METHODS["tdpg"].judge is choose_by_critic_two
    assert METHODS["tdpg-base"].judge is None


@pytest.mark.parametrize(
    ("p", "goal", "expected"), [(0.65, 0, GRASP), (0.75, 1, PUSH), (0.8, 1, GRASP)]
)
def test_critic_two_must_be_surer_when_a_goal_is_fetched(
    p: float, goal: bool, expected: Choice
) -> None:
    shown = np.ones((SIZE, SIZE), np.bool_)
    heightmap = table_with(goal=shown if goal else None)
    judge = METHODS["tdpg-sure"].judge_of(heightmap)
    assert judge is not None
    assert judge(GRASP, (GRASP,), PUSH, np.array([p])) is expected
    assert METHODS["tdpg"].judge_of(heightmap) is choose_by_critic_two
    assert METHODS["epg"].judge_of(heightmap) is None


def test_epg_pushes_while_the_goal_is_hemmed_in() -> None:
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[100:120, 100:120] = True
    free = table_with((100, 100, 20, 20, 0.05), goal=goal)
    hemmed_in = table_with((80, 80, 60, 60, 0.05), goal=goal)
    choose = METHODS["epg"].choose
    assert choose is not None
    assert choose([GRASP], PUSH, free) is GRASP
    assert choose([GRASP], PUSH, hemmed_in) is PUSH
    assert choose([dataclasses.replace(GRASP, q=0.9)], PUSH, free) is PUSH
    assert choose([GRASP], None, hemmed_in) is GRASP
    assert choose([], PUSH, free) is PUSH
    assert choose([], None, free) is None
