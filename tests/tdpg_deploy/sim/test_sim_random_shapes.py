from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from tdpg_deploy.sim.links import MAX_WIDTH
from tdpg_deploy.sim.random_shapes import random_shape

seeds = st.integers(0, 2**32 - 1)


@given(seeds)
def test_it_is_one_convex_thing_about_its_centre_of_mass_that_fits_between_the_fingers(
    seed: int,
) -> None:
    shape = random_shape(np.random.default_rng(seed))
    (piece,) = shape.pieces
    hull = ConvexHull(piece.vertices)
    np.testing.assert_allclose(shape.volume, hull.volume, rtol=1e-6)
    rng = np.random.default_rng(0)
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    points = rng.uniform(low, high, (20_000, 3))
    inside = (points @ hull.equations[:, :3].T + hull.equations[:, 3] <= 0).all(axis=1)
    np.testing.assert_allclose(points[inside].mean(axis=0), 0, atol=0.002)
    assert min(high - low) < MAX_WIDTH
    assert max(high - low) < 0.1


def test_the_same_generator_makes_the_same_shape() -> None:
    first, second = (random_shape(np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first.vertices, second.vertices)
    assert first.rolls == second.rolls
