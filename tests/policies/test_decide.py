from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from tables import table_with

from policies.decide import (
    best,
    best_grasps,
    choose_by_critic_one,
    choose_by_critic_two,
    choose_if_sure,
    choose_surest,
    to_primitive,
)
from policies.heightmap import SIZE
from policies.policy import HALF_TURN, ROTATIONS, Choice, QMaps
from policies.primitives import PUSH_LENGTH, Grasp, Push

SHAPE = (ROTATIONS, SIZE, SIZE)
BLOCK = (100, 100, 20, 20, 0.05)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


# --- choice -----------------------------------------------------------------------------------


def test_equals_are_drawn_evenly() -> None:
    values = np.full((2, 3, 3), -np.inf, np.float32)
    values[0, 1, 2] = values[1, 0, 0] = 0.5
    generator = rng()
    drawn = [best(values, "push", generator) for _ in range(200)]
    first = sum(choice is not None and choice.rotation == 0 for choice in drawn)
    assert 70 < first < 130  # five sigma of a fair coin
    assert best(values, "push", rng()) == best(values, "push", rng())


def test_nothing_allowed_is_no_choice() -> None:
    nothing = np.full(SHAPE, -np.inf, np.float32)
    assert best(nothing, "push", rng()) is None
    assert best_grasps(QMaps(grasp=nothing, push=nothing), rng()) == ()
    assert choose_by_critic_one((), None) is None


def test_the_ten_best_grasps_are_ten_different_ones() -> None:
    grasp = np.random.default_rng(1).random(SHAPE).astype(np.float32)
    grasp[8:] = grasp[:8]
    grasps = best_grasps(QMaps(grasp=grasp, push=grasp), rng())
    assert len(grasps) == 10
    assert grasps[0].q == grasp.max()
    assert [g.q for g in grasps] == sorted((g.q for g in grasps), reverse=True)
    for i, a in enumerate(grasps):
        for b in grasps[:i]:
            turns = abs(a.rotation - b.rotation)
            near = np.hypot(a.row - b.row, a.col - b.col) <= 5 and min(turns, 8 - turns) <= 1
            assert not near


def test_the_best_grasps_of_a_goal_come_before_better_ones_beside_it() -> None:
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[100:120, 100:120] = True
    grasp = np.where(goal, np.float32(0.2), np.float32(0.8)) * np.ones(SHAPE, np.float32)
    grasps = best_grasps(QMaps(grasp=grasp, push=grasp), rng(), goal=goal, count=2)
    assert [bool(goal[g.row, g.col]) for g in grasps] == [True, True, False, False]
    grasp[:, goal] = -np.inf
    grasps = best_grasps(QMaps(grasp=grasp, push=grasp), rng(), goal=goal, count=2)
    assert [bool(goal[g.row, g.col]) for g in grasps] == [False, False]


def test_grasps_that_surely_hold_come_before_better_ones() -> None:
    """With a goal: those on it, sure or not, before any beside it."""
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[100:120, 100:120] = True
    sure = np.zeros((HALF_TURN, SIZE, SIZE), np.bool_)
    sure[3] = True
    grasp = np.full(SHAPE, 0.8, np.float32)
    grasp[[3, 11]] = 0.2
    maps = QMaps(grasp=grasp, push=grasp)
    assert [g.rotation == 3 for g in best_grasps(maps, rng(), sure=sure, count=2)] == [
        True,
        True,
        False,
        False,
    ]
    grasps = best_grasps(maps, rng(), goal=goal, sure=sure, count=1)
    assert [(bool(goal[g.row, g.col]), g.rotation == 3) for g in grasps] == [
        (True, True),
        (True, False),
        (False, True),
        (False, False),
    ]


def choice(kind: Literal["grasp", "push"], q: float) -> Choice:
    return Choice(kind=kind, rotation=0, row=0, col=0, q=q)


TEN = tuple(choice("grasp", 1 - i / 10) for i in range(10))
PUSH = choice("push", 0.8)


def test_critic_one_takes_the_higher_value() -> None:
    assert choose_by_critic_one(TEN, PUSH) is TEN[0]
    assert choose_by_critic_one(TEN[3:], PUSH) is PUSH
    assert choose_by_critic_one(TEN, choice("push", 1.0)) is TEN[0]
    assert choose_by_critic_one((), PUSH) is PUSH
    assert choose_by_critic_one(TEN, None) is TEN[0]


@pytest.mark.parametrize(
    ("chosen", "p_success", "expected"),
    [
        (TEN[0], [0.9] * 10, TEN[0]),
        (TEN[0], [0.4] * 10, TEN[0]),  # 1 - P = 0.6 does not exceed c
        (TEN[0], [0.39] * 10, PUSH),
        (TEN[0], [0.39] * 4 + [0.5] * 6, TEN[4]),  # not easily replaced
        (PUSH, [0.6] * 10, PUSH),
        (PUSH, [0.59] * 2 + [0.61] * 8, TEN[2]),
        (PUSH, [0.1] * 10, PUSH),
    ],
)
def test_critic_two_swaps_at_c(chosen: Choice, p_success: list[float], expected: Choice) -> None:
    assert choose_by_critic_two(chosen, TEN, PUSH, np.array(p_success)) is expected


@pytest.mark.parametrize(
    ("chosen", "p_success", "expected"),
    [(TEN[0], 0.9, TEN[0]), (PUSH, 0.9, TEN[0]), (TEN[0], 0.89, PUSH), (PUSH, 0.5, PUSH)],
)
def test_the_best_grasp_is_made_if_critic_two_is_sure_of_it(
    chosen: Choice, p_success: float, expected: Choice
) -> None:
    judged = choose_if_sure(chosen, TEN[:1], PUSH, np.array([p_success]), least=0.9)
    assert judged is expected


@pytest.mark.parametrize(
    ("p_success", "expected"),
    [([0.9, 0.99], TEN[0]), ([0.89, 0.9], TEN[1]), ([0.89, 0.89], PUSH)],
)
def test_what_is_in_the_goals_way_is_lifted_where_that_is_sure(
    p_success: list[float], expected: Choice
) -> None:
    judged = choose_if_sure(TEN[0], TEN[:2], PUSH, np.array(p_success), least=0.9)
    assert judged is expected


@pytest.mark.parametrize(
    ("p_success", "push", "expected"),
    [
        ([0.9, 0.99, 0.95], PUSH, TEN[1]),
        ([0.2, 0.89, 0.9], PUSH, TEN[2]),
        ([0.89, 0.5, 0.2], PUSH, PUSH),
        ([0.2, 0.4, 0.3], None, TEN[1]),
    ],
)
def test_the_surest_grasp_is_made_if_it_is_sure_enough(
    p_success: list[float], push: Choice | None, expected: Choice
) -> None:
    judged = choose_surest(TEN[0], TEN[:3], push, np.array(p_success), least=0.9)
    assert judged is expected


def test_a_doubtful_grasp_is_made_when_no_push_is_allowed() -> None:
    p_success = np.array([0.2, 0.4])
    assert choose_if_sure(TEN[0], TEN[:2], None, p_success, least=0.9) is TEN[1]
    assert choose_by_critic_two(TEN[0], TEN, None, np.zeros(10)) is TEN[0]


# --- the world --------------------------------------------------------------------------------


def test_a_choice_becomes_a_primitive_at_the_centre_of_its_pixel() -> None:
    heightmap = table_with(BLOCK)
    heightmap.height[112, 112] = np.nan
    heightmap.height[108, 108] = 0.4  # a spike
    grasp = to_primitive(Choice(kind="grasp", rotation=6, row=110, col=110, q=1.0), heightmap)
    assert isinstance(grasp, Grasp)
    assert (grasp.x, grasp.y) == pytest.approx((0.724 - 0.221, 0.224 - 0.221))
    assert grasp.z == pytest.approx(-0.15 + 0.05)
    assert grasp.yaw == pytest.approx(np.deg2rad(135))
    push = to_primitive(Choice(kind="push", rotation=0, row=150, col=0, q=1.0), heightmap)
    assert isinstance(push, Push)
    assert push.z == pytest.approx(-0.15)
    assert push.length == PUSH_LENGTH
