"""Convex pieces: what bodies are made of, for the physics and for the renderer alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from tdpg_deploy.geometry import Array, Transform

TABLE = -1  # owners below zero are not objects of the scene
ROBOT = -2
BIN = -3


@dataclass(frozen=True, eq=False)
class ConvexPiece:
    """vertices: (n, 3) metres in the body's frame. planes: (m, 4), inside where n.p + d <= 0,
    normals of unit length that point outwards."""

    vertices: Array
    planes: Array

    @classmethod
    def from_vertices(cls, vertices: npt.ArrayLike) -> ConvexPiece:
        points = np.asarray(vertices, np.float64)
        hull = ConvexHull(points)
        planes = np.unique(np.round(hull.equations, 9), axis=0)  # triangles of one face are one
        return cls(points[hull.vertices], planes)


@dataclass(frozen=True, eq=False)
class VisiblePiece:
    """A piece where it is now. rgb: 0..255. owner: index of the object in the scene, or one of
    TABLE, ROBOT, BIN."""

    piece: ConvexPiece
    X_base_piece: Transform
    rgb: tuple[int, int, int]
    owner: int
