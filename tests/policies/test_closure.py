from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tables import WORKSPACE, table_with

from policies.closure import holding
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


def is_held(heightmap: Heightmap, rotation: int, row: int = ROW, col: int = COL) -> bool:
    grasps = np.zeros((HALF_TURN, SIZE, SIZE), np.bool_)
    grasps[rotation, row, col] = True
    held = holding(heightmap, grasps)
    assert not (held & ~grasps).any()
    return bool(held[rotation, row, col])


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
    """Two faces, each half the wedge from the pads, all of it turned a little between them."""
    along, across = along_and_across(rotation)
    half, turn = np.radians(wedge / 2), np.radians(turned)
    left = 0.019 + side * across * np.tan(half + turn)
    right = 0.019 + side * across * np.tan(half - turn)
    solid = (along <= left) & (along >= -right) & (abs(across) <= 0.012)
    assert is_held(standing(solid), rotation) == (wedge < 75)


@given(
    st.integers(0, HALF_TURN - 1), st.floats(0.028, 0.034), st.floats(0, 0.3) | st.floats(0.85, 0.9)
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
    assert is_held(standing(bar), rotation)


def test_the_corner_of_a_block_is_squeezed_out_and_its_sides_are_held() -> None:
    block = table_with((100, 100, 24, 24, 0.05))
    assert is_held(block, 0, 112, 112)
    assert is_held(block, 4, 112, 112)
    assert not is_held(block, 6, 104, 104)  # across the upper left corner
    assert is_held(block, 2, 112, 112)  # from corner to corner, which lean both ways alike


def test_what_the_fingers_reach_above_does_not_count() -> None:
    """A disc on a plate whose corner would slip out."""
    along, across = along_and_across(2)
    plate = (abs(along) <= 0.03 - across) & (across >= -0.012)
    tower = standing(plate, 0.03)
    assert not is_held(tower, 2)
    tower.height[along**2 + across**2 <= 0.02**2] = 0.08
    assert is_held(tower, 2)


def test_nothing_is_asked_of_no_grasps_and_holes_are_no_faces() -> None:
    heightmap = table_with((100, 100, 24, 24, 0.05))
    assert not holding(heightmap, np.zeros((HALF_TURN, SIZE, SIZE), np.bool_)).any()
    heightmap.height[90:98, 90:130] = np.nan
    assert is_held(heightmap, 0, 112, 112)
