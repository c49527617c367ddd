"""Convex things that nobody designed, to learn from: stones and stumps.

Each fits between the fingers on one side at least. Shape frames and units as in `bodies`.
"""

from __future__ import annotations

import numpy as np

from tdpg_deploy.geometry import Array
from tdpg_deploy.sim.bodies import SHAPES, Shape

_STONE_CORNERS = 8, 16
_LEAST, _MOST = 0.017, 0.036  # m from the axis to a side
_LENGTH = 0.030, 0.090  # m along the axis
_ROUND = 9  # sides from which on a stump rolls


def odd_shapes(rng: np.random.Generator) -> dict[str, Shape]:
    """As many stones and stumps for a table as there are blocks."""
    return {str(number): random_shape(rng) for number in range(len(SHAPES))}


def random_shape(rng: np.random.Generator) -> Shape:
    """A stone or a stump, with equal chance."""
    return _stone(rng) if rng.random() < 0.5 else _stump(rng)


def _stone(rng: np.random.Generator) -> Shape:
    """The hull of random points on an ellipsoid."""
    radii = [*rng.uniform(_LEAST, _MOST, 2), rng.uniform(*_LENGTH) / 2]
    points = rng.normal(size=(rng.integers(*_STONE_CORNERS), 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return Shape.from_hulls("stone", [points * radii])


def _stump(rng: np.random.Generator) -> Shape:
    """A prism that narrows and leans: three sides to almost round."""
    sides = int(rng.integers(3, 17))
    angles = 2 * np.pi * (np.arange(sides) + rng.uniform(-0.2, 0.2, sides)) / sides
    foot = rng.uniform(_LEAST, _MOST, 2) * np.column_stack([np.cos(angles), np.sin(angles)])
    head = foot * rng.uniform(0.4, 1.0) + rng.uniform(-0.01, 0.01, 2)
    length = rng.uniform(*_LENGTH)
    return Shape.from_hulls(
        "stump", [np.vstack([_at(foot, 0.0), _at(head, length)])], rolls=sides >= _ROUND
    )


def _at(outline: Array, z: float) -> Array:
    """(n, 3) of an outline (n, 2) at a height."""
    return np.column_stack([outline, np.full(len(outline), z)])
