from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_sim_packed_scene import WORKSPACE, corners, gap

from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.sim.clusters import clustered_scene


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_clusters_stand_tight_within_the_workspace(seed: int, compact: bool) -> None:
    scene = clustered_scene(WORKSPACE, np.random.default_rng(seed), compact=compact)
    scene.check(WORKSPACE)
    placed = [corners(item) for item in scene.objects]
    assert len(placed) >= 2
    for points in placed:
        assert points[:, 2].min() >= WORKSPACE.table_z - 1e-9
        assert all(WORKSPACE.contains(x, y, margin=0.029) for x, y, _ in points)
    gaps = []
    for one, other in combinations(placed, 2):
        above = one[:, 2].min() >= other[:, 2].max() - 1e-9
        below = other[:, 2].min() >= one[:, 2].max() - 1e-9
        if not (above or below):
            gaps.append(gap(one, other))
    # Nothing stands in another thing, as far as `gap` can tell: 0.1 m by an eighth of a degree.
    assert min(gaps, default=0.0) > -3e-4


def test_some_things_stand_on_others_and_some_tables_have_several_clusters() -> None:
    scenes = [clustered_scene(WORKSPACE, np.random.default_rng(seed)) for seed in range(30)]
    lifted = [
        corners(item)[:, 2].min() > WORKSPACE.table_z + 0.01
        for scene in scenes
        for item in scene.objects
    ]
    assert 0.02 < np.mean(lifted) < 0.3
    spread = [
        np.ptp([item.X_base_object.translation[:2] for item in scene.objects], axis=0).max()
        for scene in scenes
    ]
    assert max(spread) > 0.24 > min(spread)


def test_more_is_hemmed_in_where_a_cluster_is_compact() -> None:
    """Neighbours within a finger's thickness of each thing."""

    def neighbours(compact: bool) -> float:
        counts = []
        for seed in range(20):
            scene = clustered_scene(WORKSPACE, np.random.default_rng(seed), compact=compact)
            placed = [corners(item) for item in scene.objects]
            counts += [sum(gap(one, other) < 0.018 for other in placed) - 1 for one in placed]
        return float(np.mean(counts))

    assert neighbours(compact=True) > neighbours(compact=False) + 0.5


@pytest.mark.slow
def test_a_cluster_stays_as_it_was_laid() -> None:
    config = load_cell(DEFAULT_CELL)
    for seed in range(3):
        scene = clustered_scene(WORKSPACE, np.random.default_rng(seed))
        with open_cell(config, scene=scene, seed=seed) as cell:
            assert cell.truth is not None
            assert cell.truth()["workspace"] == len(scene.objects)
