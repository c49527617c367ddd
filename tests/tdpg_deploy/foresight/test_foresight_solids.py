from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from seen import CONFIG, TABLE_Z, block, row_of_bars, seen

from policies.heightmap import SIZE, Heightmap
from tdpg_deploy.cell import open_cell
from tdpg_deploy.foresight.solids import scene_shown
from tdpg_deploy.geometry import Array
from tdpg_deploy.sim.scenes import Scene, SceneObject
from tdpg_deploy.workspace import workspace_of


def standing(item: SceneObject) -> Array:
    """Its corners in base."""
    pose = item.X_base_object
    corners: Array = item.shape.vertices @ pose.rotation.as_matrix().T + pose.translation
    return corners


def sticks_out(points: Array, of: Array) -> float:
    """Metres by which any of some points lies outside of the convex hull of others, from above."""
    planes = ConvexHull(of[:, :2]).equations
    return float((points[:, :2] @ planes[:, :2].T + planes[:, 2]).max())


def middle(points: Array) -> Array:
    """x, y of the smallest box around them."""
    between: Array = (points.min(axis=0) + points.max(axis=0))[:2] / 2
    return between


@pytest.mark.parametrize("name", ["bar", "plank", "cube", "tile", "cylinder"])
@pytest.mark.parametrize("yaw", [0.0, 0.3, 0.8, 1.4])
def test_a_block_is_as_large_and_where_it_is(name: str, yaw: float) -> None:
    there = block(name, 0.52, 0.03, yaw)
    (shown,) = scene_shown(seen(Scene(objects=(there,))).heightmap).objects
    truth, solid = standing(there), standing(shown)
    assert sticks_out(solid, truth) < 0.003
    assert sticks_out(truth, solid) < 0.004
    assert abs(ConvexHull(solid[:, :2]).volume / ConvexHull(truth[:, :2]).volume - 1) < 0.08
    assert solid[:, 2].min() == pytest.approx(TABLE_Z)
    assert np.ptp(solid[:, 2]) == pytest.approx(np.ptp(truth[:, 2]), abs=0.003)
    np.testing.assert_allclose(middle(solid), middle(truth), atol=0.002)


@pytest.mark.parametrize("yaw", [0.2, 0.7])
def test_a_box_has_its_corners(yaw: float) -> None:
    """Noise and votes round them off by 3 mm; blocks would turn past each other."""
    there = block("bar", 0.5, 0.0, yaw)
    (shown,) = scene_shown(seen(Scene(objects=(there,))).heightmap).objects
    assert sticks_out(standing(there), standing(shown)) < 0.002


def test_blocks_that_touch_do_not_overlap_much() -> None:
    solids = [standing(item) for item in scene_shown(seen(row_of_bars()).heightmap).objects]
    solids.sort(key=lambda solid: solid[:, 1].mean())
    for left, right in pairwise(solids):
        assert left[:, 1].max() - right[:, 1].min() < 0.003


def test_the_goal_is_told_apart() -> None:
    shown = scene_shown(seen(row_of_bars()).heightmap).objects
    assert [item.goal for item in shown].count(True) == 1
    (goal,) = (item for item in shown if item.goal)
    np.testing.assert_allclose(goal.X_base_object.translation[:2], [0.5, 0.0], atol=0.003)


def test_an_empty_table_is_an_empty_scene() -> None:
    assert scene_shown(seen(Scene(objects=())).heightmap).objects == ()


@pytest.mark.slow
@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_whatever_is_seen_a_world_can_hold_it(seed: int) -> None:
    """Blocks, slivers and specks that lie across each other, holes, and noise."""
    rng = np.random.default_rng(seed)
    height, color = np.zeros((SIZE, SIZE), np.float32), np.zeros((SIZE, SIZE, 3), np.uint8)
    for _ in range(rng.integers(1, 25)):
        row, col = rng.integers(0, SIZE, 2)
        rows, cols = rng.integers(1, 40, 2)
        height[row : row + rows, col : col + cols] = rng.uniform(0.005, 0.15)
        color[row : row + rows, col : col + cols] = rng.integers(0, 256, 3)
    height += rng.normal(0, rng.choice([0, 0.002, 0.01]), height.shape).astype(np.float32)
    height[rng.random(height.shape) < rng.choice([0, 0.05, 0.5])] = np.nan
    goal = np.roll(np.arange(SIZE) < 40, rng.integers(SIZE))[:, None] & (np.arange(SIZE) < 120)
    workspace = workspace_of(CONFIG)
    scene = scene_shown(Heightmap(workspace=workspace, color=color, height=height, goal=goal))
    with open_cell(CONFIG, scene=scene) as cell:
        assert cell.truth is not None
        assert sum(cell.truth().values()) == len(scene.objects)
