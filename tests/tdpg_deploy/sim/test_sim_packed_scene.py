from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.errors import SceneError
from tdpg_deploy.geometry import Array
from tdpg_deploy.sim.scenes import MAX_PACKED, PACK_GAP, SceneObject, packed_scene
from tdpg_deploy.workspace import workspace_of

WORKSPACE = workspace_of(load_cell(DEFAULT_CELL))


def corners(item: SceneObject) -> Array:
    """(n, 3) in base."""
    return np.asarray(item.X_base_object @ item.shape.vertices)


def gap(a: Array, b: Array) -> float:
    """Metres between two convex outlines seen from above: the largest along any normal of their
    edges, which for these is any direction; below zero where they overlap."""
    angles = np.linspace(0, np.pi, 720, endpoint=False)
    directions = np.stack([np.cos(angles), np.sin(angles)])
    p, q = a[:, :2] @ directions, b[:, :2] @ directions
    between = np.maximum(p.min(axis=0) - q.max(axis=0), q.min(axis=0) - p.max(axis=0))
    return float(between.max())


@settings(max_examples=25)
@given(st.integers(2, MAX_PACKED), st.integers(0, 2**32 - 1))
def test_a_pack_stands_tight_on_the_table_within_the_workspace(n: int, seed: int) -> None:
    scene = packed_scene(n, WORKSPACE, np.random.default_rng(seed))
    placed = [corners(item) for item in scene.objects]
    assert len(placed) == n
    for points in placed:
        assert points[:, 2].min() == pytest.approx(WORKSPACE.table_z)
        assert all(WORKSPACE.contains(x, y, margin=0.029) for x, y, _ in points)
    gaps = [gap(*pair) for pair in combinations(placed, 2)]
    assert 0 < min(gaps) <= PACK_GAP + 1e-9
    assert gap(*placed[:2]) <= PACK_GAP + 1e-9  # beside it, or behind it where the row is full


@pytest.mark.parametrize("n", [0, MAX_PACKED + 1])
def test_a_pack_of_too_many_is_refused(n: int) -> None:
    with pytest.raises(SceneError, match="ask for 1 to 9"):
        packed_scene(n, WORKSPACE, np.random.default_rng(0))
