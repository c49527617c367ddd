from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tables import WORKSPACE, table_with

from policies.closure import MAX_WEDGE, SURE_WEDGE, wedges
from policies.heightmap import PIXEL, SIZE, Heightmap
from policies.policy import HALF_TURN, ROTATIONS

ROW, COL = 110, 120
Array = npt.NDArray[np.float64]


def along_and_across(rotation: int) -> tuple[Array, Array]:
    """Metres from the middle of the map's pixel (ROW, COL), along a yaw and to its left."""
    x, y = np.meshgrid(
        (ROW - np.arange(SIZE)) * PIXEL, (COL - np.arange(SIZE)) * PIXEL, indexing="ij"
    )
    yaw = rotation * 2 * np.pi / ROTATIONS
    return x * np.cos(yaw) + y * np.sin(yaw), y * np.cos(yaw) - x * np.sin(yaw)


def standing(solid: npt.NDArray[np.bool_], top: float = 0.05) -> Heightmap:
    height = np.where(solid, top, 0.0).astype(np.float32)
    return Heightmap(workspace=WORKSPACE, color=np.zeros((SIZE, SIZE, 3), np.uint8), height=height)


def wedge_at(
    heightmap: Heightmap, rotation: int, row: int = ROW, col: int = COL, *, ground: float = 0.0
) -> float:
    grasps = np.zeros((HALF_TURN, SIZE, SIZE), np.bool_)
    grasps[rotation, row, col] = True
    wedge = wedges(heightmap, grasps, ground)
    assert np.isinf(wedge[~grasps]).all()
    return float(wedge[rotation, row, col])


def is_held(heightmap: Heightmap, rotation: int, row: int = ROW, col: int = COL) -> bool:
    return bool(wedge_at(heightmap, rotation, row, col) <= MAX_WEDGE)


def is_surely_held(heightmap: Heightmap, rotation: int, row: int = ROW, col: int = COL) -> bool:
    return bool(wedge_at(heightmap, rotation, row, col) <= SURE_WEDGE)


def wedge_between(rotation: int, wedge: float, side: int, turned: float) -> Heightmap:
    """Two faces, each half the wedge (degrees) from the pads, all of it turned a little between
    them."""
    along, across = along_and_across(rotation)
    half, turn = np.radians(wedge / 2), np.radians(turned)
    left = 0.019 + side * across * np.tan(half + turn)
    right = 0.019 + side * across * np.tan(half - turn)
    return standing((along <= left) & (along >= -right) & (abs(across) <= 0.012))


@given(
    st.integers(0, HALF_TURN - 1),
    st.floats(0, 65) | st.floats(85, 110),
    st.sampled_from([-1, 1]),
    st.floats(-8, 8),
)
@settings(max_examples=60)
def test_a_wedge_slips_out_where_it_opens_by_more_than_twice_the_friction_angle(
    rotation: int, wedge: float, side: int, turned: float
) -> None:
    held = wedge_between(rotation, wedge, side, turned)
    assert is_held(held, rotation) == (wedge < 75)
    if wedge < 50:
        assert is_surely_held(held, rotation)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_wedge_near_twice_the_friction_angle_is_not_surely_held(side: int) -> None:
    held = wedge_between(0, 67, side, 0)
    assert is_held(held, 0)
    assert not is_surely_held(held, 0)


@given(
    st.integers(0, HALF_TURN - 1),
    st.floats(0.028, 0.034),
    st.floats(0, 0.3) | st.floats(0.85, 0.9),
)
@settings(max_examples=60)
def test_a_disc_is_held_near_its_middle(rotation: int, radius: float, beside: float) -> None:
    """A chord that far from the middle, in radii, meets faces turned by its arc sine each; the
    pads reach from there by a third of a radius to both sides."""
    along, across = along_and_across(rotation)
    disc = along**2 + (across - beside * radius) ** 2 <= radius**2
    assert is_held(standing(disc), rotation) == (beside < 0.5)


@pytest.mark.parametrize("rotation", range(HALF_TURN))
def test_a_bar_is_held_however_it_is_turned(rotation: int) -> None:
    along, across = along_and_across(rotation)
    turn = np.radians(30)
    bar = abs(along * np.cos(turn) + across * np.sin(turn)) <= 0.015
    assert is_surely_held(standing(bar), rotation)


def test_the_corner_of_a_block_is_squeezed_out_and_its_sides_are_held() -> None:
    block = table_with((100, 100, 24, 24, 0.05))
    assert is_surely_held(block, 0, 112, 112)
    assert is_surely_held(block, 4, 112, 112)
    assert not is_held(block, 6, 104, 104)  # across the upper left corner
    assert is_surely_held(block, 2, 112, 112)  # from corner to corner, which lean both ways alike


def test_what_the_fingers_reach_above_does_not_count() -> None:
    """A disc on a plate whose corner would slip out."""
    along, across = along_and_across(2)
    plate = (abs(along) <= 0.03 - across) & (across >= -0.012)
    tower = standing(plate, 0.03)
    assert not is_held(tower, 2)
    tower.height[along**2 + across**2 <= 0.02**2] = 0.08
    assert is_surely_held(tower, 2)


def test_nothing_is_asked_of_no_grasps_and_holes_are_no_faces() -> None:
    heightmap = table_with((100, 100, 24, 24, 0.05))
    assert np.isinf(wedges(heightmap, np.zeros((HALF_TURN, SIZE, SIZE), np.bool_), 0.0)).all()
    heightmap.height[90:98, 90:130] = np.nan
    assert is_surely_held(heightmap, 0, 112, 112)


def roof(rotation: int, wedge: float) -> Heightmap:
    """40 mm high, 60 mm long, 24 mm wide at its ridge, which runs across a yaw, its slopes half
    the wedge (degrees) from the upright."""
    along, across = along_and_across(rotation)
    steepness = 1 / np.tan(np.radians(max(wedge, 0.1) / 2))
    height = 0.04 - np.maximum(abs(along) - 0.012, 0) * steepness
    heightmap = standing(np.zeros((SIZE, SIZE), np.bool_))
    heightmap.height[:] = np.where(abs(across) <= 0.03, np.maximum(height, 0), 0)
    return heightmap


@given(st.integers(0, HALF_TURN - 1), st.floats(0, 85))
@settings(max_examples=60)
def test_the_slopes_of_a_roof_make_its_wedge_and_its_gables_make_none(
    rotation: int, wedge: float
) -> None:
    pixel = np.arctan2(PIXEL, 0.016)  # that each outline may err, over what a face is followed up
    heightmap = roof(rotation, wedge)
    measured = wedge_at(heightmap, rotation)
    assert np.radians(wedge) - 4 * pixel <= measured <= np.radians(wedge) + 2 * pixel
    assert wedge_at(heightmap, (rotation + HALF_TURN // 2) % HALF_TURN) <= 2 * pixel


def test_only_what_the_pads_can_reach_of_a_slope_counts() -> None:
    """A roof on walls: fingers that come down to the walls hold it, fingers that what stands
    around keeps up meet its slopes."""
    heightmap = roof(0, 90)
    height = heightmap.height
    height[:] = np.where(height > 0.02, height + 0.01, 0)
    assert wedge_at(heightmap, 0) <= np.radians(20)
    assert wedge_at(heightmap, 0, ground=0.025) > MAX_WEDGE


@given(st.integers(0, HALF_TURN - 1), st.floats(0.03, 0.038))
@settings(max_examples=30)
def test_a_ball_is_held_about_its_middle_and_not_from_above(rotation: int, radius: float) -> None:
    along, across = along_and_across(rotation)
    rest = radius**2 - along**2 - across**2
    ball = standing(rest > 0)
    ball.height[:] = np.where(rest > 0, radius + np.sqrt(np.maximum(rest, 0)), 0)
    assert wedge_at(ball, rotation) <= np.radians(40)
    assert wedge_at(ball, rotation, ground=1.4 * radius) > np.radians(45)


def test_a_lone_high_line_is_no_face() -> None:
    """Noise in front of a block, one pixel wide."""
    heightmap = table_with((100, 100, 24, 24, 0.05))
    before = wedge_at(heightmap, 0, 112, 112)
    heightmap.height[92, 112] = 0.02
    assert wedge_at(heightmap, 0, 112, 112) == before
