from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tables import goal_at, table_with

from policies.pushable import all_pushes, pushable

BLOCK = (100, 100, 20, 20, 0.05)


def test_the_first_pushes_for_a_goal_have_it_slide_out_alone() -> None:
    """A row of three long blocks, the goal in the middle."""
    goal = goal_at(slice(90, 130), slice(100, 120))
    row = [(90, col, 40, 20, 0.05) for col in (79, 100, 121)]
    alone, over, *_ = pushable(table_with(*row, goal=goal))
    assert alone[0, 140, 110]  # against its end, from below
    assert alone[8, 80, 110]  # and from above
    assert not alone[:, :, :90].any()
    assert not alone[:, :, 130:].any()
    assert over[4, 110, 150]  # from the right, with its neighbour ahead


def test_a_push_for_a_goal_meets_the_goal_or_what_is_beside_it() -> None:
    goal = goal_at(slice(100, 120), slice(100, 120))
    near, far = (100, 130, 20, 20, 0.05), (50, 50, 20, 20, 0.05)
    *_, any_push = pushable(table_with(BLOCK, near, far, goal=goal))
    assert any_push[4, 110, 160]  # from the right into the neighbour
    assert any_push[0, 130, 110]
    assert not any_push[12, 60, 30]
    assert all_pushes(table_with(BLOCK, near, far))[12, 60, 30]


def test_the_first_pushes_go_through_the_middle_of_the_widest_pile() -> None:
    row = [(100, col, 20, 20, 0.05) for col in (80, 100, 120)]  # 120 mm wide
    alone = (150, 40, 20, 20, 0.05)
    middle, long, _ = pushable(table_with(*row, alone))
    assert middle[0, 130, 110]
    assert long[0, 130, 85]  # at its left end
    assert not middle[0, 130, 85]
    assert long[0, 180, 50]  # through the middle of less
    assert not middle[0, 180, 50]
    assert not (middle & ~long).any()


def test_pushes_that_go_on_for_long_come_before_shorter_ones() -> None:
    _, long, short = pushable(table_with(BLOCK))
    assert long[0, 130, 110]  # 20 mm below it: 110 mm are left
    assert not long[0, 134, 110]
    assert short[0, 134, 110]


def test_the_last_kind_is_all_of_them() -> None:
    goal = goal_at(slice(90, 130), slice(100, 120))
    row = [(90, col, 40, 20, 0.05) for col in (79, 100, 121)]
    for heightmap in (table_with(*row), table_with(*row, goal=goal)):
        *_, every = pushable(heightmap)
        np.testing.assert_array_equal(every, all_pushes(heightmap))
        assert every.any()


def test_a_push_starts_beside_the_block_and_runs_into_it() -> None:
    mask = all_pushes(table_with(BLOCK))
    up, left, down, right = 0, 4, 8, 12  # yaw 0, 90, 180, 270 degrees
    assert mask[up, 130, 110]
    assert mask[left, 110, 130]
    assert mask[down, 90, 110]
    assert mask[right, 110, 90]
    assert not mask[down, 130, 110]  # away from it
    assert not mask[up, 190, 110]  # 70 pixels below its edge: out of reach
    assert not mask[up, 175, 110]  # in reach, but at its end
    assert mask[up, 168, 110]
    assert not mask[:, 110, 110].any()  # on top of it nothing stands higher
    assert not mask[:, 10, 10].any()


def test_a_push_that_would_slide_along_a_block_is_not_allowed() -> None:
    mask = all_pushes(table_with(BLOCK))
    assert mask[0, 140, 121]
    assert not mask[0, 130:160, 124].any()  # 8 mm beside it


def test_a_push_from_a_low_block_meets_a_higher_one() -> None:
    mask = all_pushes(table_with((100, 100, 20, 20, 0.05), (120, 100, 20, 20, 0.03)))
    assert mask[0, 130, 110]  # from the lower, up, into the higher
    assert not mask[8, 110, 110]  # from the higher, down, over the lower


def test_a_push_neither_starts_on_unknown_ground_nor_ends_near_the_border() -> None:
    heightmap = table_with((30, 100, 20, 20, 0.05), BLOCK)
    heightmap.height[125:140, :] = np.nan
    mask = all_pushes(heightmap)
    assert not mask[0, 130, 110]
    assert mask[0, 150, 110]
    down = all_pushes(table_with((140, 100, 20, 20, 0.05)))[8, :, 110]
    assert down[128]
    assert not down[129]  # it would end 29 pixels from the border: 58 mm


@pytest.mark.parametrize(("col", "kept"), [(100, range(16)), (180, range(9))])
def test_a_push_leaves_the_goal_in_the_workspace(col: int, kept: Sequence[int]) -> None:
    """Rotations 0 to 8 are straight up, to the left, straight down. Of what is beside the goal too,
    for it may stand between the fingers and the goal."""
    blocks = (100, col, 20, 20, 0.05), (100, col - 21, 20, 20, 0.05)
    heightmap = table_with(*blocks, goal=goal_at(slice(100, 120), slice(col, col + 20)))
    assert set(np.flatnonzero(all_pushes(heightmap).any(axis=(1, 2)))) == set(kept)
