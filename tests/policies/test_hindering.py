from __future__ import annotations

import numpy as np
import pytest
from tables import goal_at, table_with

from policies.heightmap import SIZE
from policies.hindering import hindering, in_the_way
from policies.standing import Mask

GOAL = (90, 100, 50, 20, 0.05)  # 100 by 40 mm: to be grasped across
LEFT, RIGHT = (90, 79, 50, 20, 0.05), (90, 121, 50, 20, 0.05)


def around(*others: tuple[int, int, int, int, float], goal: bool = True) -> Mask:
    shown = np.zeros((SIZE, SIZE), np.bool_)
    shown[90:140, 100:120] = goal
    return hindering(table_with(GOAL, *others, goal=shown))


def test_nothing_hinders_a_goal_that_stands_free() -> None:
    assert not around((20, 20, 40, 40, 0.08)).any()


def test_a_neighbour_hinders_and_not_beyond_a_finger() -> None:
    left = around(LEFT)
    assert left[:, 88:99].any()
    assert not left[:, :79].any()
    assert not left[:, 100:].any()


def test_a_goal_is_grasped_where_one_neighbour_hinders_instead_of_two() -> None:
    rows, cols = np.nonzero(around(LEFT, (90, 121, 25, 20, 0.05)))
    assert (cols < 100).mean() > 0.9  # within a tenth of a finger tip it may graze the other
    assert rows.min() > 110


def test_both_neighbours_hinder_a_goal_between_them() -> None:
    both = around(LEFT, RIGHT)
    assert both[:, 79:99].any()
    assert both[:, 121:141].any()
    assert not both[:, :79].any()
    assert not both[:, 141:].any()


@pytest.mark.parametrize(("top", "hinders"), [(0.10, True), (0.05, False)])
def test_what_is_high_is_in_the_palms_way(top: float, hinders: bool) -> None:
    """28 mm from the goal's end, beside both fingers: the palm reaches 33 mm to each side."""
    beyond = (20, 80, 79, 60, top)
    short = np.zeros((SIZE, SIZE), np.bool_)
    short[100:110, 100:120] = True
    found = hindering(table_with((100, 100, 10, 20, 0.05), beyond, goal=short))
    assert found.any() == hinders


def test_what_may_lie_on_the_goal_comes_before_what_stands_around() -> None:
    at_its_end, lower = (90, 121, 10, 20, 0.07), (90, 121, 10, 20, 0.06)
    expected = np.zeros((SIZE, SIZE), np.bool_)
    expected[90:100, 121:126] = True  # 12 mm from it
    np.testing.assert_array_equal(around(LEFT, at_its_end), expected)
    assert around(LEFT, lower)[:, :100].any()


def test_a_lone_high_pixel_does_not_lie_on_the_goal() -> None:
    assert not around((90, 122, 1, 1, 0.1)).any()


def test_nothing_hinders_a_goal_too_large_to_grasp() -> None:
    goal = goal_at(slice(80, 130), slice(80, 130))
    beside = (80, 131, 50, 20, 0.05)
    assert not hindering(table_with((80, 80, 50, 50, 0.05), beside, goal=goal)).any()


def test_nothing_hinders_a_goal_that_is_not_seen() -> None:
    assert not around(LEFT, goal=False).any()


def test_what_stands_within_a_finger_of_what_hinders_is_in_the_way() -> None:
    goal = goal_at(slice(90, 140), slice(100, 120))
    way = in_the_way(table_with(GOAL, LEFT, (90, 121, 50, 20, 0.05), goal=goal))
    assert way[90:140, 79:99].all()
    assert not way[:, :60].any()


def test_all_beside_a_goal_that_nothing_hinders_is_in_the_way() -> None:
    rows, cols = np.nonzero(
        in_the_way(table_with(GOAL, goal=goal_at(slice(90, 140), slice(100, 120))))
    )
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (65, 164, 75, 144)
