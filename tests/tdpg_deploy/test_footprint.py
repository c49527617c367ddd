from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from policies.heightmap import RIM, SIZE, WIDE, Heightmap, Workspace
from tdpg_deploy.footprint import Rectangle, ground_under

WORKSPACE = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)


def heightmap(height: float = 0.0) -> Heightmap:
    return Heightmap(
        workspace=WORKSPACE,
        color=np.zeros((SIZE, SIZE, 3), np.uint8),
        height=np.full((SIZE, SIZE), height, np.float32),
    )


@given(st.floats(-np.pi, np.pi), st.integers(40, 180), st.integers(40, 180))
def test_finds_a_marked_spot_wherever_it_turns(yaw: float, row: int, col: int) -> None:
    seen = heightmap()
    seen.height[row - 1 : row + 2, col - 1 : col + 2] = 0.07
    x, y = WORKSPACE.to_base(row, col)
    # Its middle lies 8 mm ahead of the rectangle's centre: inside 20 x 6 mm, outside 6 x 20 mm.
    centre = {"x": float(x - 0.008 * np.cos(yaw)), "y": float(y - 0.008 * np.sin(yaw))}
    ahead = Rectangle(**centre, yaw=yaw, along=0.020, across=0.006)
    across = Rectangle(**centre, yaw=yaw, along=0.006, across=0.020)
    assert ground_under(seen, ahead, clear_margin=0.0).highest == pytest.approx(0.07)
    assert ground_under(seen, across, clear_margin=0.0).highest == 0.0


def test_a_hole_is_unknown_not_table() -> None:
    seen = heightmap(0.02)
    row, _ = WORKSPACE.to_pixel(0.5, 0.0)
    seen.height[:row, :] = np.nan  # all beyond x = 0.5
    square = Rectangle(x=0.5, y=0.0, yaw=0.0, along=0.02, across=0.02)
    ground = ground_under(seen, square, clear_margin=0.1)
    assert ground.unknown == pytest.approx(0.5, abs=0.08)
    assert ground.highest == pytest.approx(0.02)
    seen.height[:] = np.nan
    ground = ground_under(seen, square, clear_margin=0.1)
    assert ground.unknown == 1.0
    assert np.isnan(ground.highest)


def test_beyond_the_map_only_what_the_owner_vouches_for_is_known() -> None:
    outside = Rectangle(x=WORKSPACE.x_max + 0.03, y=0.0, yaw=0.0, along=0.02, across=0.02)
    assert ground_under(heightmap(), outside, clear_margin=0.0).unknown == 1.0
    assert ground_under(heightmap(), outside, clear_margin=0.05).unknown == 0.0


def test_what_was_seen_beyond_the_map_is_known() -> None:
    rim = np.full((WIDE, WIDE), np.nan, np.float32)
    rim[:RIM] = 0.04  # away from the robot
    seen = replace(heightmap(), rim=rim)
    outside = Rectangle(x=WORKSPACE.x_max + 0.03, y=0.0, yaw=0.0, along=0.02, across=0.02)
    ground = ground_under(seen, outside, clear_margin=0.0)
    assert ground.highest == pytest.approx(0.04)
    assert ground.unknown == 0.0
    beside = replace(outside, x=0.5, y=WORKSPACE.y_max + 0.03)
    assert ground_under(seen, beside, clear_margin=0.0).unknown == 1.0
    assert ground_under(seen, beside, clear_margin=0.05).highest == 0.0
