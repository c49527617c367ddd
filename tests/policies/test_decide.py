from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tables import WORKSPACE, table_with

from policies.decide import (
    Choice,
    Map,
    allowed,
    best,
    best_grasps,
    best_push,
    choose_by_critic_one,
    choose_by_critic_two,
    choose_if_sure,
    graspable,
    pushable,
    rising,
    to_primitive,
)
from policies.heightmap import SIZE, Heightmap
from policies.policy import ROTATIONS, QMaps
from policies.primitives import Grasp, Push

SHAPE = (ROTATIONS, SIZE, SIZE)
BLOCK = (100, 100, 20, 20, 0.05)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def zeros() -> QMaps:
    return QMaps(grasp=np.zeros(SHAPE, np.float32), push=np.zeros(SHAPE, np.float32))


def is_allowed(values: Map) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return ~np.isneginf(values)


# --- masks ------------------------------------------------------------------------------------


def test_what_rises_is_the_block_alone() -> None:
    heightmap = table_with(BLOCK)
    heightmap.height[10, 10] = 0.03  # a speck
    heightmap.height[30:60, 30:60] = np.nan  # a hole
    heightmap.height[:, 200:] = 0.004  # noise of the table
    rows, cols = np.nonzero(rising(heightmap))
    # The corner pixels of a square have three neighbours.
    assert len(rows) == 20 * 20 - 4
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (100, 119, 100, 119)


def test_with_a_goal_a_grasp_is_allowed_on_it_and_on_what_surrounds_it() -> None:
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[100:120, 100:120] = True
    walls = (100, 60, 60, 40, 0.05), (100, 120, 60, 40, 0.05), (120, 100, 40, 20, 0.05)
    above, far = (60, 100, 40, 20, 0.05), (20, 20, 20, 20, 0.05)
    mask = graspable(table_with(BLOCK, *walls, above, far, goal=goal))
    assert not (mask & goal).any()  # no finger fits beside it
    assert mask[4, 88, 110]  # on its upper neighbour
    assert not mask[:, 70, 110].any()  # the same, but 60 mm from the goal
    assert not mask[:, 30, 30].any()
    assert graspable(table_with(BLOCK, *walls[:2], far, goal=goal))[0, 110, 110]


def test_a_push_for_a_goal_meets_the_goal_or_what_surrounds_it() -> None:
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[100:120, 100:120] = True
    near, far = (100, 130, 20, 20, 0.05), (50, 50, 20, 20, 0.05)
    mask = pushable(table_with(BLOCK, near, far, goal=goal))
    assert mask[4, 110, 160]  # from the right into the neighbour
    assert mask[0, 130, 110]
    assert not mask[0, 80, 60]
    assert pushable(table_with(BLOCK, near, far))[0, 80, 60]


def test_a_grasp_needs_room_for_both_fingers() -> None:
    wall = (100, 122, 20, 60, 0.05)  # a finger's width away, to the right
    mask = graspable(table_with(BLOCK, wall))
    across, along = 4, 0  # closing direction: left and right; up and down
    assert not mask[[across, across + 8], 110, 110].any()
    assert mask[[along, along + 8], 110, 110].all()
    assert not graspable(table_with(BLOCK, (*wall[:4], 0.04)))[across, 110, 110]
    assert graspable(table_with(BLOCK, (*wall[:4], 0.029)))[across, 110, 110]


def test_a_grasp_needs_seen_ground_for_both_fingers() -> None:
    heightmap = table_with(BLOCK)
    heightmap.height[:, 125:160] = np.nan
    mask = graspable(heightmap)
    assert not mask[4, 110, 110]
    assert mask[0, 110, 110]


def test_a_push_starts_beside_the_block_and_runs_into_it() -> None:
    mask = pushable(table_with(BLOCK))
    up, left, down, right = 0, 4, 8, 12  # yaw 0, 90, 180, 270 degrees
    assert mask[up, 130, 110]
    assert mask[left, 110, 130]
    assert mask[down, 90, 110]
    assert mask[right, 110, 90]
    assert not mask[down, 130, 110]  # away from it
    assert not mask[up, 175, 110]  # 55 pixels below its edge: out of reach
    assert not mask[up, 165, 110]  # in reach, but at its end
    assert mask[up, 154, 110]
    assert not mask[:, 110, 110].any()  # on top of it nothing stands higher
    assert not mask[:, 10, 10].any()


def test_a_push_that_would_slide_along_a_block_is_not_allowed() -> None:
    mask = pushable(table_with(BLOCK))
    assert mask[0, 140, 121]
    assert not mask[0, 130:160, 124].any()  # 8 mm beside it


def test_a_push_from_a_low_block_meets_a_higher_one() -> None:
    mask = pushable(table_with((100, 100, 20, 20, 0.05), (120, 100, 20, 20, 0.03)))
    assert mask[0, 130, 110]  # from the lower, up, into the higher
    assert not mask[8, 110, 110]  # from the higher, down, over the lower


def test_a_push_neither_starts_on_unknown_ground_nor_ends_near_the_border() -> None:
    heightmap = table_with((30, 100, 20, 20, 0.05), BLOCK)
    heightmap.height[125:140, :] = np.nan
    mask = pushable(heightmap)
    assert not mask[0, 130, 110]
    assert mask[0, 150, 110]
    assert not mask[0, 79, 110]  # it would end 29 pixels from the border: 58 mm
    assert mask[0, 80, 110]


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_what_is_allowed_keeps_its_promises(seed: int) -> None:
    generator = np.random.default_rng(seed)
    height = np.zeros((SIZE, SIZE), np.float32)
    for _ in range(generator.integers(0, 6)):
        row, col = generator.integers(0, SIZE - 20, 2)
        height[row : row + 20, col : col + 12] = generator.uniform(0.01, 0.08)
    height[generator.random(height.shape) < 0.1] = np.nan
    heightmap = Heightmap(
        workspace=WORKSPACE, color=np.zeros((SIZE, SIZE, 3), np.uint8), height=height
    )
    maps = allowed(zeros(), heightmap)
    for choice in (*best_grasps(maps, generator), best_push(maps, generator)):
        if choice is None:
            continue
        primitive = to_primitive(choice, heightmap)
        assert np.isfinite(height[choice.row, choice.col])
        assert WORKSPACE.contains(primitive.x, primitive.y)
        if isinstance(primitive, Push):
            assert WORKSPACE.contains(
                primitive.x + primitive.length * np.cos(primitive.yaw),
                primitive.y + primitive.length * np.sin(primitive.yaw),
                margin=-1e-9,
            )
        else:
            assert height[choice.row, choice.col] > 0.005


def test_a_grasp_is_avoided_from_both_sides() -> None:
    heightmap = table_with(BLOCK)
    x, y = (float(value) for value in heightmap.workspace.to_base(110, 110))
    before = is_allowed(allowed(zeros(), heightmap).grasp)
    after = is_allowed(
        allowed(zeros(), heightmap, [Grasp(x=x, y=y, z=0.0, yaw=15 * np.pi / 8)]).grasp
    )
    struck = before & ~after
    rotations, rows, cols = np.nonzero(struck)
    assert set(rotations) == {14, 15, 0, 6, 7, 8}
    assert np.hypot(rows - 110, cols - 110).max() == 5  # 10 mm
    assert struck[15, 110, 115]


def test_a_push_is_avoided_in_its_direction_alone() -> None:
    heightmap = table_with(BLOCK)
    x, y = (float(value) for value in heightmap.workspace.to_base(140, 118))
    maps = allowed(zeros(), heightmap, [Push(x=x, y=y, z=0.0, yaw=0.0)])
    assert not is_allowed(maps.push)[[15, 0, 1], 140, 118].any()
    assert is_allowed(maps.push)[2, 140, 118]
    assert is_allowed(maps.grasp)[0, 110, 110]


def test_what_is_avoided_may_lie_outside_of_the_map() -> None:
    heightmap = table_with(BLOCK)
    far = [Grasp(x=x, y=y, z=0.0, yaw=0.0) for x in (-5.0, 0.275, 5.0) for y in (-5.0, 0.0, 5.0)]
    before, after = allowed(zeros(), heightmap), allowed(zeros(), heightmap, far)
    np.testing.assert_array_equal(before.grasp, after.grasp)


def test_a_corner_is_grasped_only_when_nothing_else_is_left() -> None:
    wide = table_with((80, 80, 50, 50, 0.05))  # 100 mm: wider than the fingers open
    corners = graspable(wide)
    assert corners.any()
    assert not is_allowed(allowed(zeros(), wide).grasp).any()  # there are pushes
    no_push = QMaps(grasp=zeros().grasp, push=np.full(SHAPE, -np.inf, np.float32))
    np.testing.assert_array_equal(is_allowed(allowed(no_push, wide).grasp), corners)


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
    assert choose_if_sure(chosen, TEN[:1], None, np.zeros(1), least=0.9) is TEN[0]


@pytest.mark.parametrize(
    ("p_success", "expected"),
    [([0.9, 0.99], TEN[0]), ([0.89, 0.9], TEN[1]), ([0.89, 0.89], PUSH)],
)
def test_what_is_in_the_goals_way_is_lifted_where_that_is_sure(
    p_success: list[float], expected: Choice
) -> None:
    judged = choose_if_sure(TEN[0], TEN[:2], PUSH, np.array(p_success), least=0.9)
    assert judged is expected


def test_a_doubtful_grasp_is_made_when_no_push_is_allowed() -> None:
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
    assert push.length == 0.10
