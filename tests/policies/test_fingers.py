from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tables import WORKSPACE, table_with

from policies.fingers import Ground, under_closed_gripper, under_open_gripper
from policies.gripper import CLOSED_GRIPPER, OPEN_GRIPPER, Part, have_room
from policies.heightmap import INSIDE, SIZE, WIDE, Heightmap
from policies.policy import ROTATIONS
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy.footprint import ground_under, rectangles

pixels = st.integers(0, SIZE - 1)
rotations = st.integers(0, 7)


def hills(seed: int) -> Heightmap:
    """Smooth ground, some of the map unseen: no two pixels side by side differ by 3 mm."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:WIDE, :WIDE]
    rim = np.zeros((WIDE, WIDE), np.float32)
    for _ in range(4):
        at = rng.uniform(0, WIDE, 2)
        rim += 0.06 * np.exp(-((row - at[0]) ** 2 + (col - at[1]) ** 2) / (2 * 25**2))
    height = rim[INSIDE, INSIDE].copy()
    height[rng.integers(SIZE) :, rng.integers(SIZE) :] = np.nan
    rim[INSIDE, INSIDE] = np.nan
    return Heightmap(
        workspace=WORKSPACE,
        color=np.zeros((SIZE, SIZE, 3), np.uint8),
        height=height,
        rim=rim,
    )


def agrees(
    ground: Ground,
    seen: Heightmap,
    at: tuple[int, int, int],
    primitive: Primitive,
    parts: Sequence[Part],
) -> None:
    """With each part's places sampled finely, one by one, as plans are checked."""
    exact = [
        (part, ground_under(seen, place, clear_margin=0.1))
        for part in parts
        for place in rectangles(part, primitive)
    ]
    unknown = max(ground.unknown for part, ground in exact if part is parts[0])
    if unknown > 0.35:
        assert not ground.known[at]
    if unknown < 0.05:
        assert ground.known[at]
    if all(below.unknown < 0.05 for _, below in exact):
        highest = max(0.0, *(below.highest - part.rise for part, below in exact))
        assert abs(ground.highest[at] - highest) < 0.012


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 9), rotations, pixels, pixels)
def test_the_ground_is_that_of_the_plan(seed: int, rotation: int, row: int, col: int) -> None:
    seen = hills(seed)
    x, y = (float(value) for value in WORKSPACE.to_base(row, col))
    yaw = rotation * 2 * np.pi / ROTATIONS
    at = rotation, row, col
    grasp, push = Grasp(x=x, y=y, z=0, yaw=yaw), Push(x=x, y=y, z=0, yaw=yaw)
    agrees(under_open_gripper(seen), seen, at, grasp, OPEN_GRIPPER)
    agrees(under_closed_gripper(seen), seen, at, push, CLOSED_GRIPPER)


def test_a_speck_is_not_ground() -> None:
    seen = table_with()
    seen.height[100, 100] = 0.3
    assert under_open_gripper(seen).highest.max() == 0.0
    assert under_closed_gripper(seen).highest.max() == 0.0


def test_flat_things_may_be_grasped_from_the_table() -> None:
    surface = np.array([0.012, 0.012, 0.05, 0.05, np.nan])
    ground = np.array([0.009, 0.011, 0.029, 0.031, 0.0])
    np.testing.assert_array_equal(have_room(surface, ground), [True, False, True, False, False])
