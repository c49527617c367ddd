"""Boxes whose place is known, rendered and fitted again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from policies.heightmap import SIZE, Heightmap, Workspace
from tools.replay.box_fit import fit_boxes

WORKSPACE = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)


def heightmap(*boxes: tuple[float, float, float, float, float, float]) -> Heightmap:
    """Seen without noise. A box: x, y, length, width, height (m), yaw (rad)."""
    x, y = WORKSPACE.to_base(*np.indices((SIZE, SIZE)))
    height = np.zeros((SIZE, SIZE), np.float32)
    for x_mid, y_mid, length, width, top, yaw in boxes:
        u = (x - x_mid) * np.cos(yaw) + (y - y_mid) * np.sin(yaw)
        v = (y - y_mid) * np.cos(yaw) - (x - x_mid) * np.sin(yaw)
        inside = (np.abs(u) <= length / 2) & (np.abs(v) <= width / 2)
        height[inside] = np.maximum(height[inside], top)
    color = np.full((SIZE, SIZE, 3), 90, np.uint8)
    return Heightmap(workspace=WORKSPACE, color=color, height=height)


@settings(deadline=None, max_examples=30)
@given(
    x=st.floats(0.35, 0.65),
    y=st.floats(-0.15, 0.15),
    length=st.floats(0.03, 0.10),
    width=st.floats(0.03, 0.10),
    top=st.floats(0.02, 0.08),
    yaw=st.floats(0, np.pi),
)
def test_a_box_is_found_where_it_stands(
    x: float, y: float, length: float, width: float, top: float, yaw: float
) -> None:
    (fitted,) = fit_boxes(heightmap((x, y, length, width, top, yaw))).objects
    vertices = fitted.X_base_object @ fitted.shape.vertices
    assert vertices.mean(axis=0)[:2] == pytest.approx([x, y], abs=0.002)
    assert vertices[:, 2].min() == pytest.approx(WORKSPACE.table_z, abs=1e-6)
    assert vertices[:, 2].max() == pytest.approx(WORKSPACE.table_z + top, abs=1e-6)
    assert fitted.shape.volume == pytest.approx(length * width * top, rel=0.25)


def test_two_that_touch_are_told_apart_by_their_heights() -> None:
    scene = fit_boxes(heightmap((0.48, 0, 0.04, 0.05, 0.05, 0), (0.52, 0, 0.04, 0.05, 0.025, 0)))
    assert len(scene.objects) == 2
    tops = sorted(np.ptp(item.shape.vertices[:, 2]) for item in scene.objects)
    assert tops == pytest.approx([0.025, 0.05], abs=1e-6)


def test_an_empty_table_has_none() -> None:
    assert fit_boxes(heightmap()).objects == ()


def test_specks_are_no_boxes() -> None:
    assert fit_boxes(heightmap((0.5, 0, 0.01, 0.01, 0.03, 0))).objects == ()
