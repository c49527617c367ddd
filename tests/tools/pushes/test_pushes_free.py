"""What counts as free, on tables whose answer is plain."""

from __future__ import annotations

import numpy as np
import pytest

from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.geometry import Transform
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.scenes import Scene, SceneObject
from tools.goals import detector_of
from tools.train.pushes.free import free, look, on_table, taken_by_grasps
from tools.train.trainer import training_cell

CUBE = SHAPES["cube"]
HALF = 0.025  # m


def cell_with(*places: tuple[float, float]) -> Cell:
    """Cubes at x, y (m) from the middle of the workspace, faces along its sides."""
    config = training_cell()
    x, y = config.workspace.center
    objects = tuple(
        SceneObject(
            shape=CUBE,
            X_base_object=Transform.from_quaternion(
                (x + dx, y + dy, config.workspace.table_z + HALF), (0, 0, 0, 1)
            ),
            rgb=(200, 60, 30),
        )
        for dx, dy in places
    )
    return open_cell(config, scene=Scene(objects=objects))


GRID = [(0.051 * i, 0.051 * j) for i in (-1, 0, 1) for j in (-1, 0, 1)]


def test_a_cube_that_stands_alone_is_free_and_one_in_a_grid_is_not() -> None:
    with cell_with((0.0, 0.0), (0.12, 0.05)) as cell:
        np.testing.assert_array_equal(free(*look(cell), 2), [True, True])
    with cell_with(*GRID) as cell:
        assert not free(*look(cell), 9)[4]


def test_pixels_know_their_object() -> None:
    with cell_with((-0.1, 0.0), (0.1, 0.05)) as cell:
        heightmap, owners = look(cell)
        world = detector_of(cell).world
        for state in world.objects():
            row, col = heightmap.workspace.to_pixel(*state.X_base_object.translation[:2])
            assert owners[row, col] == state.index
        assert owners[0, 0] == -1


def test_a_row_is_taken_from_its_ends_and_a_grid_is_stuck() -> None:
    """Three in a row: the fingers fit around the row's width, and none is in the way for ever. Nine
    in a grid: each is hemmed in on two sides that are not opposite, or more."""
    with cell_with((0.0, 0.0), (0.051, 0.0), (0.102, 0.0)) as cell:
        assert taken_by_grasps(detector_of(cell).world).all()
    with cell_with(*GRID) as cell:
        assert not taken_by_grasps(detector_of(cell).world)[4]


@pytest.mark.parametrize("fallen", [0, 1])
def test_what_left_the_workspace_is_neither_there_nor_taken(fallen: int) -> None:
    with cell_with((0.0, 0.0), (0.12, 0.05)) as cell:
        world = detector_of(cell).world
        away = world.objects()[fallen].X_base_object
        away = Transform(away.rotation, away.translation + np.array([0.5, 0, 0]))
        world._drop(fallen, away)
        expected = np.arange(2) != fallen
        np.testing.assert_array_equal(on_table(world), expected)
        np.testing.assert_array_equal(taken_by_grasps(world), expected)
