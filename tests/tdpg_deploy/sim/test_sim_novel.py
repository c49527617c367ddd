from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tdpg_deploy.change import GONE_VOLUME
from tdpg_deploy.geometry import Array
from tdpg_deploy.sim.bodies import SHAPES, Shape
from tdpg_deploy.sim.links import MAX_WIDTH
from tdpg_deploy.sim.novel import NOVEL, ellipsoid, turned, wall

EACH = pytest.mark.parametrize("shape", NOVEL.values(), ids=NOVEL.keys())


def lattice(shape: Shape) -> tuple[Array, Array]:
    """Points 1 mm apart, (n, 3), and how many pieces each is inside of."""
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    axes = [np.arange(a, b, 0.001) + 0.0005 for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    counts = np.zeros(len(points))
    for piece in shape.pieces:
        counts += (points @ piece.planes[:, :3].T + piece.planes[:, 3] <= 0).all(axis=1)
    return points, counts


def test_at_least_twenty_that_training_never_saw() -> None:
    assert len(NOVEL) >= 20
    assert not NOVEL.keys() & SHAPES.keys()
    assert all(name == shape.name for name, shape in NOVEL.items())


@EACH
def test_fits_between_the_fingers_and_is_missed_when_gone(shape: Shape) -> None:
    angles = np.radians(np.arange(0, 180, 5))
    around = [np.column_stack([np.cos(angles), np.sin(angles)]) @ np.eye(3)[[i, j]]
              for i, j in ((0, 1), (1, 2), (2, 0))]  # fmt: skip
    widths = np.ptp(shape.vertices @ np.concatenate(around).T, axis=0)
    assert widths.min() < MAX_WIDTH - 0.01
    assert shape.volume > 1.5 * GONE_VOLUME


@EACH
def test_is_made_of_pieces_that_do_not_overlap_around_its_centre_of_mass(shape: Shape) -> None:
    points, counts = lattice(shape)
    assert counts.max() == 1 or (counts > 1).sum() < 0.01 * (counts > 0).sum()
    inside = points[counts > 0]
    assert_allclose(inside.mean(axis=0), 0, atol=3e-4)
    assert_allclose(len(inside) * 1e-9, shape.volume, rtol=0.03)


def test_hollow_ones_are_hollow() -> None:
    for name in ("mug", "bowl", "ring", "hexagon_nut"):
        shape = NOVEL[name]
        top = shape.vertices[:, 2].max() - 0.005
        axis = np.array([0.0, 0.0, top]) - (0.003 if name == "mug" else 0.0, 0, 0)
        for piece in shape.pieces:
            assert (piece.planes[:, :3] @ axis + piece.planes[:, 3]).max() > 0


def test_volumes_by_their_formulas() -> None:
    cone = Shape.from_hulls("cone", turned((0.03, 0), (0.01, 0.06)))
    base = 16 / 2 * np.sin(2 * np.pi / 16)  # area of a regular 16-gon of radius 1
    assert_allclose(cone.volume, 0.06 / 3 * base * (0.03**2 + 0.03 * 0.01 + 0.01**2))
    tube = Shape.from_hulls("tube", wall((0.01, 0.02, 0), (0.01, 0.02, 0.05), pieces=6))
    assert_allclose(tube.volume, 6 / 2 * np.sin(np.pi / 3) * (0.02**2 - 0.01**2) * 0.05)
    points = ellipsoid(0.03, 0.02, 0.01)
    assert_allclose(((points / (0.03, 0.02, 0.01)) ** 2).sum(axis=1), 1, atol=1e-6)
