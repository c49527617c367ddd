"""The shapes of objects: rigid unions of convex pieces, generated here; blocks as large as VPG's.

A shape's frame has its origin at the centre of mass (uniform density). Metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, Delaunay

from tdpg_deploy.geometry import Array
from tdpg_deploy.sim.pieces import ConvexPiece

CYLINDER_SIDES = 16


@dataclass(frozen=True, eq=False)
class Shape:
    """pieces: convex, not overlapping, in a frame at the centre of mass.

    rolls: has a curved side, so that the physics must damp its rolling.
    """

    name: str
    pieces: tuple[ConvexPiece, ...]
    rolls: bool = False

    @classmethod
    def from_hulls(cls, name: str, hulls: Sequence[npt.ArrayLike], *, rolls: bool = False) -> Shape:
        """The union of the convex hulls of point sets (n, 3) in any one frame."""
        points = [np.asarray(hull, np.float64) for hull in hulls]
        volumes, centroids = zip(*(_volume_and_centroid(hull) for hull in points), strict=True)
        center = np.average(centroids, axis=0, weights=volumes)
        pieces = tuple(ConvexPiece.from_vertices(hull - center) for hull in points)
        return cls(name, pieces, rolls)

    @property
    def volume(self) -> float:
        """Cubic metres."""
        return sum(_volume_and_centroid(piece.vertices)[0] for piece in self.pieces)

    @property
    def vertices(self) -> Array:
        """(n, 3) of all pieces."""
        return np.concatenate([piece.vertices for piece in self.pieces])


def box(x: float, y: float, z: float, *, center: tuple[float, float, float] = (0, 0, 0)) -> Array:
    """(8, 3) corners of an axis-aligned box with sides x, y, z."""
    return np.array(list(product((-0.5, 0.5), repeat=3))) * (x, y, z) + center


def cylinder(radius: float, bottom: float, top: float) -> Array:
    """(32, 3) corners of a regular prism about z, with the cylinder's radius at its corners."""
    angles = np.arange(CYLINDER_SIDES) * (2 * np.pi / CYLINDER_SIDES)
    return extrude(radius * np.column_stack([np.cos(angles), np.sin(angles)]), bottom, top)


def extrude(outline: npt.ArrayLike, bottom: float, top: float) -> Array:
    """(2n, 3) corners of the prism that stands on an outline (n, 2)."""
    xy = np.asarray(outline, np.float64)
    return np.concatenate([np.column_stack([xy, np.full(len(xy), z)]) for z in (bottom, top)])


def _volume_and_centroid(vertices: Array) -> tuple[float, Array]:
    """Of a convex hull, as the sum of the tetrahedra that fill it."""
    corners = vertices[ConvexHull(vertices).vertices]
    tetrahedra = corners[Delaunay(corners).simplices]  # (m, 4, 3)
    edges = tetrahedra[:, 1:] - tetrahedra[:, :1]
    volumes = np.abs(np.linalg.det(edges)) / 6
    return float(volumes.sum()), np.average(tetrahedra.mean(axis=1), axis=0, weights=volumes)


def _arch() -> list[Array]:
    """A block .093 x .050 x .049 with a half round tunnel of radius .025 along y."""
    width, depth, height, radius = 0.093, 0.050, 0.049, 0.025
    leg = (width - 2 * radius) / 2
    legs = [
        box(leg, depth, height, center=(side * (radius + leg / 2), 0, height / 2))
        for side in (-1, 1)
    ]
    angles = np.linspace(0, np.pi, 5)
    crown = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    wedges = []
    for a, b in pairwise(crown):
        outline = np.array([a, b, (b[0], height), (a[0], height)])
        prism = extrude(outline, -depth / 2, depth / 2)
        wedges.append(prism[:, [0, 2, 1]])  # the outline stands upright, in x and z
    return legs + wedges


def _half_cylinder() -> Array:
    """Radius .045 along y, flat side down, .050 long."""
    angles = np.linspace(0, np.pi, CYLINDER_SIDES // 2 + 1)
    half_disc = 0.045 * np.column_stack([np.cos(angles), np.sin(angles)])
    return extrude(half_disc, -0.025, 0.025)[:, [0, 2, 1]]


SHAPES: Mapping[str, Shape] = {
    shape.name: shape
    for shape in (
        Shape.from_hulls("arch", _arch()),
        Shape.from_hulls("bar", [box(0.100, 0.050, 0.050)]),
        Shape.from_hulls("tile", [box(0.060, 0.060, 0.025)]),
        Shape.from_hulls("plank", [box(0.100, 0.050, 0.025)]),
        Shape.from_hulls("cube", [box(0.050, 0.050, 0.050)]),
        Shape.from_hulls("slab", [box(0.050, 0.050, 0.025)]),
        Shape.from_hulls("cylinder", [cylinder(0.0225, -0.025, 0.025)], rolls=True),
        Shape.from_hulls("half_cylinder", [_half_cylinder()], rolls=True),
        Shape.from_hulls(
            "triangle",
            [extrude([(-0.035, 0), (0.035, 0), (0, 0.035)], -0.025, 0.025)[:, [0, 2, 1]]],
        ),
    )
}
"""The nine blocks by name. Bounding boxes after VPG's: arch, bars, tiles, cylinder, prisms."""
