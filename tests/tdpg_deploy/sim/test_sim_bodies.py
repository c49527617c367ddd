from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tdpg_deploy.geometry import Array
from tdpg_deploy.sim.bodies import SHAPES, Shape, box, cylinder

BOUNDING_BOXES = {  # m: the blocks that visual pushing-grasping was trained on
    "arch": (0.093, 0.050, 0.049),
    "bar": (0.100, 0.050, 0.050),
    "tile": (0.060, 0.060, 0.025),
    "plank": (0.100, 0.050, 0.025),
    "cube": (0.050, 0.050, 0.050),
    "slab": (0.050, 0.050, 0.025),
    "cylinder": (0.045, 0.045, 0.050),
}


def sampled_moments(shape: Shape) -> tuple[float, Array]:
    """Volume and centre of mass by counting points of a lattice: slow, and independent."""
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    axes = [np.arange(a, b, 0.001) + 0.0005 for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.zeros(len(points), bool)
    for piece in shape.pieces:
        inside |= (points @ piece.planes[:, :3].T + piece.planes[:, 3] <= 0).all(axis=1)
    return inside.sum() * 1e-9, points[inside].mean(axis=0)


def test_there_are_nine_blocks() -> None:
    assert len(SHAPES) == 9
    assert all(name == shape.name for name, shape in SHAPES.items())


@pytest.mark.parametrize("name", BOUNDING_BOXES)
def test_blocks_have_the_published_size(name: str) -> None:
    vertices = SHAPES[name].vertices
    assert_allclose(np.ptp(vertices, axis=0), BOUNDING_BOXES[name], atol=1e-9)


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
def test_origin_is_the_centre_of_mass(shape: Shape) -> None:
    volume, center = sampled_moments(shape)
    assert_allclose(center, 0, atol=2e-4)
    assert_allclose(volume, shape.volume, rtol=0.03)


def test_the_arch_is_concave() -> None:
    arch = SHAPES["arch"]
    under_the_crown = np.array([0.0, 0.0, arch.vertices[:, 2].min() + 0.005])
    for piece in arch.pieces:
        assert (piece.planes[:, :3] @ under_the_crown + piece.planes[:, 3]).max() > 0


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
def test_pieces_touch_but_do_not_overlap(shape: Shape) -> None:
    """The volumes of the pieces add up to the volume of the union."""
    volume, _ = sampled_moments(shape)
    alone = sum(sampled_moments(Shape(shape.name, (piece,)))[0] for piece in shape.pieces)
    assert_allclose(alone, volume, rtol=0.03)


def test_a_shape_can_be_any_union_of_hulls() -> None:
    hammer = Shape.from_hulls(
        "hammer",
        [box(0.02, 0.02, 0.1, center=(1, 2, 0.05)), box(0.08, 0.02, 0.02, center=(1, 2, 0.11))],
    )
    # Two boxes of 40 and 32 cm^3 with centres at z = 0.05 and 0.11.
    assert_allclose(hammer.volume, 72e-6)
    assert_allclose(hammer.vertices[:, 2].min(), -(40 * 0.05 + 32 * 0.11) / 72)


def test_a_cylinder_is_a_sixteen_gon() -> None:
    assert cylinder(0.5, 0, 1).shape == (32, 3)
