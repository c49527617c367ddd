"""The tables of tdpg-eval: the cases as they lie, and goals that can be seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import distance_matrix

from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.errors import SceneError
from tdpg_deploy.geometry import Array
from tdpg_deploy.sim.links import MAX_WIDTH
from tdpg_deploy.sim.scenes import Scene
from tdpg_deploy.sim.world import World
from tools.evaluate.tables import CaseTable, RandomTable, SceneTable, challenge_cases
from tools.goals import in_sight

CELL = load_cell(DEFAULT_CELL)
CASES = challenge_cases()


def centres(scene: Scene) -> Array:
    return np.array([item.X_base_object.translation for item in scene.objects])


def test_three_cases_on_each_of_three_levels() -> None:
    levels = [case.groups[1] for case in CASES]
    assert levels == sorted(levels)
    assert [levels.count(f"cases, level {level}") for level in ("I", "II", "III")] == [3, 3, 3]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.file.stem)
def test_a_case_is_at_rest_and_its_one_goal_in_sight(case: CaseTable) -> None:
    scene = case.scene(CELL, 501, goal=True)
    world = World(CELL, scene, seed=501)
    for item, state in zip(scene.objects, world.objects(), strict=True):
        metres, radians = item.X_base_object.distance(state.X_base_object)
        assert metres < 0.002
        assert radians < np.radians(1)
    world.close()
    (goal,) = [index for index, item in enumerate(scene.objects) if item.goal]
    with open_cell(CELL, scene=scene, seed=501) as opened:
        assert goal in in_sight(opened)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.file.stem)
def test_a_seed_moves_a_case_as_a_whole(case: CaseTable) -> None:
    one, again, other = (centres(case.scene(CELL, seed, goal=False)) for seed in (1, 1, 2))
    assert (one == again).all()
    assert np.abs(one - other).max() > 0.005
    assert np.abs(distance_matrix(one, one) - distance_matrix(other, other)).max() < 1e-9
    assert np.ptp(one[:, 2] - other[:, 2]) < 1e-9


def test_a_case_is_laid_on_the_table_of_any_cell() -> None:
    workspace = CELL.workspace.model_copy(update={"center": (0.6, 0.1), "table_z": 0.02})
    elsewhere = CELL.model_copy(update={"workspace": workspace})
    case = CASES[0]
    moved = centres(case.scene(elsewhere, 3, goal=False)) - centres(case.scene(CELL, 3, goal=False))
    assert np.abs(moved - [0.1, 0.1, 0.17]).max() < 1e-9


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.file.stem)
def test_no_finger_fits_between_the_goal_and_its_neighbour(case: CaseTable) -> None:
    """Two blocks that touch are wider than the gripper opens."""
    scene = case.scene(CELL, 1, goal=False)
    (goal,) = [item for item in scene.objects if item.goal]
    here = goal.X_base_object @ goal.shape.vertices
    gaps = []
    for item in scene.objects:
        there = item.X_base_object @ item.shape.vertices
        if item is not goal and abs(there[:, 2].min() - here[:, 2].min()) < 0.005:
            toward = item.X_base_object.translation - goal.X_base_object.translation
            axes = goal.X_base_object.rotation.as_matrix()[:, :2].T
            for axis in axes:
                side = np.sign(toward @ axis) * axis
                gap, width = (
                    (there @ side).min() - (here @ side).max(),
                    np.ptp(np.concatenate([there, here]) @ side),
                )
                if abs(gap) < 0.004:
                    gaps.append(width)
    assert gaps
    assert min(gaps) > MAX_WIDTH


def test_the_goal_of_a_random_table_is_one_that_the_first_look_shows() -> None:
    table = RandomTable(objects=12)
    scene = table.scene(CELL, 502, goal=True)
    (goal,) = [index for index, item in enumerate(scene.objects) if item.goal]
    with open_cell(CELL, scene=scene, seed=502) as opened:
        assert goal in in_sight(opened)
    same = table.scene(CELL, 502, goal=False)
    assert (centres(same) == centres(scene)).all()


def test_a_file_without_a_goal(tmp_path: Path) -> None:
    text = CASES[0].file.read_text().replace("goal = true\n", "")
    file = tmp_path / "aimless.toml"
    file.write_text(text)
    assert SceneTable(file=file).scene(CELL, 0, goal=False).objects
    with pytest.raises(SceneError, match=r"aimless\.toml: no object is marked goal = true"):
        SceneTable(file=file).scene(CELL, 0, goal=True)
