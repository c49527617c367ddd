from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tables import WORKSPACE, goal_at, table_with

from policies.decide import best_grasps, best_push, to_primitive
from policies.fingers import under_open_gripper
from policies.heightmap import PIXEL, SIZE, Heightmap
from policies.masks import allowed, graspable
from policies.policy import ROTATIONS, QMaps
from policies.primitives import Grasp, Push
from policies.pushable import pushable
from policies.standing import Map, Mask

SHAPE = (ROTATIONS, SIZE, SIZE)
BLOCK = (100, 100, 20, 20, 0.05)


def zeros() -> QMaps:
    return QMaps(grasp=np.zeros(SHAPE, np.float32), push=np.zeros(SHAPE, np.float32))


def grasps_on(heightmap: Heightmap) -> Mask:
    return graspable(heightmap, under_open_gripper(heightmap))


def is_allowed(values: Map) -> Mask:
    return ~np.isneginf(values)


def test_with_a_goal_a_grasp_is_allowed_on_it_and_on_what_hinders_it() -> None:
    goal = goal_at(slice(100, 120), slice(100, 120))
    right, away = (100, 121, 20, 30, 0.05), (100, 40, 20, 20, 0.05)
    below, above = (121, 90, 20, 30, 0.05), (79, 90, 20, 30, 0.05)
    mask = grasps_on(table_with(BLOCK, right, below, above, away, goal=goal))
    assert not (mask & goal)[[0, 4]].any()  # no finger fits beside it
    assert mask[0, 110, 134]  # on its neighbour to the right: no more than that is to be lifted
    assert not mask[:, 110, 50].any()  # on the one to the left, which leaves room
    free = grasps_on(table_with(BLOCK, away, goal=goal))
    assert free[4, 110, 110]
    assert not free[:, 110, 50].any()  # 100 mm from it


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
    mask = grasps_on(table_with(BLOCK, wall))
    across, along = 4, 0  # closing direction: left and right; up and down
    assert not mask[[across, across + 8], 110, 110].any()
    assert mask[[along, along + 8], 110, 110].all()
    assert not grasps_on(table_with(BLOCK, (*wall[:4], 0.04)))[across, 110, 110]
    assert grasps_on(table_with(BLOCK, (*wall[:4], 0.029)))[across, 110, 110]


def test_a_grasp_needs_seen_ground_for_both_fingers() -> None:
    heightmap = table_with(BLOCK)
    heightmap.height[:, 125:160] = np.nan
    mask = grasps_on(heightmap)
    assert not mask[4, 110, 110]
    assert mask[0, 110, 110]


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
    corners = grasps_on(wide)
    assert corners.any()
    assert not is_allowed(allowed(zeros(), wide).grasp).any()  # there are pushes
    no_push = QMaps(grasp=zeros().grasp, push=np.full(SHAPE, -np.inf, np.float32))
    np.testing.assert_array_equal(is_allowed(allowed(no_push, wide).grasp), corners)


def test_what_slips_down_out_of_the_pads_is_grasped_only_when_nothing_else_is_left() -> None:
    """A ridge that slopes by 45 degrees from border to border."""
    across = abs(np.arange(SIZE) - 112) * PIXEL
    ridge = table_with()
    ridge.height[:] = np.maximum(0.045 - across, 0)
    maps = zeros()
    maps.grasp[:, :60], maps.grasp[:, 160:] = -np.inf, -np.inf  # its ends, which would be held
    assert not is_allowed(allowed(maps, ridge).grasp).any()  # there are pushes
    maps.push[:] = -np.inf
    grasps = is_allowed(allowed(maps, ridge).grasp)
    assert grasps[4, 110, 112]
    np.testing.assert_array_equal(grasps, grasps_on(ridge) & np.isfinite(maps.grasp))


def test_a_grasp_surely_holds_the_middle_of_a_side_and_not_an_end_askew() -> None:
    maps = allowed(zeros(), table_with(BLOCK))
    assert maps.sure[0, 110, 110]
    doubtful = is_allowed(maps.grasp[:8]) & ~maps.sure
    assert doubtful[7, 110, 115]  # one pad reaches round a corner
    assert not (maps.sure & ~is_allowed(maps.grasp[:8])).any()


def test_all_pushes_are_considered_or_the_most_promising_kind_of_them() -> None:
    heightmap = table_with(BLOCK)
    first, *_, every = pushable(heightmap)
    assert first.sum() < every.sum()
    promising = allowed(zeros(), heightmap).push
    np.testing.assert_array_equal(is_allowed(promising), first)
    whole = allowed(zeros(), heightmap, promising=False).push
    np.testing.assert_array_equal(is_allowed(whole), every)
    _, row, col = np.argwhere(every[:1])[0]
    x, y = (float(at) for at in heightmap.workspace.to_base(row, col))
    avoid = [Push(x=x, y=y, z=0.0, yaw=0.0)]
    assert not is_allowed(allowed(zeros(), heightmap, avoid, promising=False).push)[0, row, col]


def test_a_corner_may_be_closed_on_where_critic_two_is_to_judge_it() -> None:
    heightmap = table_with((100, 100, 24, 24, 0.05))
    held, wedged = (allowed(zeros(), heightmap, wedged=wedged) for wedged in (False, True))
    corner = 6, 104, 104
    assert not is_allowed(held.grasp)[corner]
    assert is_allowed(wedged.grasp)[corner]
    assert not wedged.sure[corner]
    np.testing.assert_array_equal(wedged.sure, held.sure)
    assert (is_allowed(wedged.grasp) >= is_allowed(held.grasp)).all()
