from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tables import WORKSPACE, table_with

from policies.decide import best_grasps, best_push, to_primitive
from policies.heightmap import SIZE, Heightmap
from policies.masks import Map, allowed, graspable, pushable, rising
from policies.policy import ROTATIONS, QMaps
from policies.primitives import Grasp, Push

SHAPE = (ROTATIONS, SIZE, SIZE)
BLOCK = (100, 100, 20, 20, 0.05)

Mask = npt.NDArray[np.bool_]


def zeros() -> QMaps:
    return QMaps(grasp=np.zeros(SHAPE, np.float32), push=np.zeros(SHAPE, np.float32))


def is_allowed(values: Map) -> Mask:
    return ~np.isneginf(values)


def any_kind(heightmap: Heightmap) -> Mask:
    *_, mask = pushable(heightmap)
    return mask


def test_what_rises_is_the_block_alone() -> None:
    heightmap = table_with(BLOCK)
    heightmap.height[10, 10] = 0.03  # a speck
    heightmap.height[30:60, 30:60] = np.nan  # a hole
    heightmap.height[:, 200:] = 0.004  # noise of the table
    rows, cols = np.nonzero(rising(heightmap))
    # The corner pixels of a square have three neighbours.
    assert len(rows) == 20 * 20 - 4
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (100, 119, 100, 119)


def goal_at(rows: slice, cols: slice) -> Mask:
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[rows, cols] = True
    return goal


def test_with_a_goal_a_grasp_is_allowed_on_it_and_on_what_hinders_it() -> None:
    goal = goal_at(slice(100, 120), slice(100, 120))
    right, away = (100, 121, 20, 30, 0.05), (100, 40, 20, 20, 0.05)
    below, above = (121, 90, 20, 30, 0.05), (79, 90, 20, 30, 0.05)
    mask = graspable(table_with(BLOCK, right, below, above, away, goal=goal))
    assert not (mask & goal)[[0, 4]].any()  # no finger fits beside it
    assert mask[0, 110, 134]  # on its neighbour to the right: no more than that is to be lifted
    assert not mask[:, 110, 50].any()  # on the one to the left, which leaves room
    free = graspable(table_with(BLOCK, away, goal=goal))
    assert free[4, 110, 110]
    assert not free[:, 110, 50].any()  # 100 mm from it


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
    assert any_kind(table_with(BLOCK, near, far))[12, 60, 30]


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


@pytest.mark.parametrize(("avoided", "shorter"), [((), False), (range(126, 135, 4), True)])
def test_shorter_pushes_are_allowed_where_the_longer_ones_are_avoided(
    avoided: Sequence[int], shorter: bool
) -> None:
    heightmap = table_with((100, 100, 20, 4, 0.05))  # no more than one column meets it squarely
    maps = zeros()
    maps.push[:] = -np.inf
    maps.push[0, :, 101] = 0.0
    places = [heightmap.workspace.to_base(at, 101) for at in avoided]
    avoid = [Push(x=float(x), y=float(y), z=0.0, yaw=0.0) for x, y in places]
    push = best_push(allowed(maps, heightmap, avoid), np.random.default_rng(0))
    assert push is not None
    assert (push.row > 133) == shorter


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
    mask = any_kind(table_with(BLOCK))
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
    mask = any_kind(table_with(BLOCK))
    assert mask[0, 140, 121]
    assert not mask[0, 130:160, 124].any()  # 8 mm beside it


def test_a_push_from_a_low_block_meets_a_higher_one() -> None:
    mask = any_kind(table_with((100, 100, 20, 20, 0.05), (120, 100, 20, 20, 0.03)))
    assert mask[0, 130, 110]  # from the lower, up, into the higher
    assert not mask[8, 110, 110]  # from the higher, down, over the lower


def test_a_push_neither_starts_on_unknown_ground_nor_ends_near_the_border() -> None:
    heightmap = table_with((30, 100, 20, 20, 0.05), BLOCK)
    heightmap.height[125:140, :] = np.nan
    mask = any_kind(heightmap)
    assert not mask[0, 130, 110]
    assert mask[0, 150, 110]
    down = any_kind(table_with((140, 100, 20, 20, 0.05)))[8, :, 110]
    assert down[128]
    assert not down[129]  # it would end 29 pixels from the border: 58 mm


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
    before = is_allowed(allowed(zeros(), heightmap).push)
    rotation, row, col = (int(index) for index in np.argwhere(before)[0])
    x, y = (float(value) for value in heightmap.workspace.to_base(row, col))

    def avoiding(turned: int) -> QMaps:
        avoided = Push(x=x, y=y, z=0.0, yaw=(rotation + turned) * np.pi / 8)
        return allowed(zeros(), heightmap, [avoided])

    after = avoiding(0)
    rotations, rows, cols = np.nonzero(before & ~is_allowed(after.push))
    assert {rotation} <= set(rotations) <= {rotation - 1, rotation, rotation + 1}
    assert np.hypot(rows - row, cols - col).max() <= 5  # 10 mm
    assert is_allowed(after.grasp)[0, 110, 110]
    assert not is_allowed(avoiding(1).push)[rotation, row, col]
    assert is_allowed(avoiding(2).push)[rotation, row, col]


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
