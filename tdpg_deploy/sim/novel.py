"""Shapes that training never saw: things of a kitchen, a desk and a workshop, from convex pieces.

Each fits between the fingers on one side at least, and is large enough for the heightmap to
witness that it is gone. Shape frames and units as in `bodies`.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from tdpg_deploy.geometry import Array
from tdpg_deploy.sim.bodies import CYLINDER_SIDES, Shape, box, cylinder, extrude

_RING_PIECES = 8


def turned(*profile: tuple[float, float]) -> list[Array]:
    """Solid of revolution about z: frustums between the (radius, z) of a profile, upwards."""
    angles = np.arange(CYLINDER_SIDES) * (2 * np.pi / CYLINDER_SIDES)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    return [
        np.concatenate([np.column_stack([r * circle, np.full(len(circle), z)]) for r, z in ends])
        for ends in pairwise(profile)
    ]


def wall(*profile: tuple[float, float, float], pieces: int = _RING_PIECES) -> list[Array]:
    """A hollow solid of revolution about z between the (inner radius, outer radius, z) of a
    profile, upwards; each storey in segments."""
    angles = np.linspace(0, 2 * np.pi, pieces + 1)
    rim = np.column_stack([np.cos(angles), np.sin(angles)])
    return [
        np.array([(*(r * end), z) for *radii, z in storey for r in radii for end in ends])
        for storey in pairwise(profile)
        for ends in pairwise(rim)
    ]


def ellipsoid(a: float, b: float, c: float, *, lowest: float = -1.0) -> Array:
    """Points of an ellipsoid with these half axes; flat at `lowest` * c if that is above -1."""
    z = np.linspace(lowest, 1, 9)
    angles = np.arange(CYLINDER_SIDES) * (2 * np.pi / CYLINDER_SIDES)
    heights, turns = np.meshgrid(z, angles)
    radii = np.sqrt(1 - heights**2)
    points = np.stack([radii * np.cos(turns), radii * np.sin(turns), heights], axis=-1)
    return np.asarray(np.unique(points.reshape(-1, 3).round(9), axis=0) * (a, b, c), np.float64)


def upright(outline: npt.ArrayLike, depth: float) -> Array:
    """A prism along y on an outline (n, 2) in x and z."""
    return extrude(outline, -depth / 2, depth / 2)[:, [0, 2, 1]]


def _star(points: int, outer: float, inner: float, height: float) -> list[Array]:
    """Spikes around a polygon."""
    tips = np.arange(points) * (2 * np.pi / points)
    notches = tips + np.pi / points
    rim = inner * np.column_stack([np.cos(notches), np.sin(notches)])
    ends = outer * np.column_stack([np.cos(tips), np.sin(tips)])
    spikes = [np.array([rim[i - 1], ends[i], rim[i]]) for i in range(points)]
    return [extrude(outline, 0, height) for outline in (rim, *spikes)]


def _crescent(radius: float, width: float, height: float) -> list[Array]:
    """Two fifths of a ring."""
    angles = np.linspace(0, 0.8 * np.pi, 6)
    rim = np.column_stack([np.cos(angles), np.sin(angles)])
    sides = np.array([[radius - width / 2], [radius + width / 2]])
    return [extrude(np.concatenate([sides * a, sides * b]), 0, height) for a, b in pairwise(rim)]


NOVEL: Mapping[str, Shape] = {
    shape.name: shape
    for shape in (
        Shape.from_hulls(
            "bottle",
            turned((0.027, 0), (0.027, 0.07), (0.012, 0.09), (0.012, 0.11)),
            rolls=True,
        ),
        Shape.from_hulls(
            "bowl",
            [cylinder(0.024, 0, 0.008), *wall((0.014, 0.024, 0.008), (0.030, 0.038, 0.042))],
            rolls=True,
        ),
        Shape.from_hulls(
            "capsule",
            [
                np.concatenate(
                    [np.add(ellipsoid(0.022, 0.022, 0.022), (x, 0, 0)) for x in (-0.025, 0.025)]
                )
            ],
            rolls=True,
        ),
        Shape.from_hulls("channel", [
            box(0.08, 0.06, 0.014, center=(0, 0, 0.007)),
            *(box(0.08, 0.014, 0.031, center=(0, y, 0.0295)) for y in (-0.023, 0.023)),
        ]),
        Shape.from_hulls("cone", turned((0.034, 0), (0.008, 0.075)), rolls=True),
        Shape.from_hulls("crescent", _crescent(0.05, 0.032, 0.032)),
        Shape.from_hulls("cross", [
            box(0.09, 0.03, 0.03),
            *(box(0.03, 0.03, 0.03, center=(0, y, 0)) for y in (-0.03, 0.03)),
        ]),
        Shape.from_hulls("dome", [ellipsoid(0.037, 0.037, 0.037, lowest=0.0)], rolls=True),
        Shape.from_hulls(
            "dumbbell",
            turned((0.027, 0), (0.027, 0.028)) + turned((0.014, 0.028), (0.014, 0.062))
            + turned((0.027, 0.062), (0.027, 0.09)),
            rolls=True,
        ),
        Shape.from_hulls("egg", [ellipsoid(0.038, 0.028, 0.028)], rolls=True),
        Shape.from_hulls("elbow", [
            box(0.08, 0.032, 0.032),
            box(0.032, 0.044, 0.032, center=(0.024, 0.038, 0)),
        ]),
        Shape.from_hulls("girder", [
            box(0.09, 0.05, 0.014, center=(0, 0, 0.018)),
            box(0.09, 0.016, 0.022),
            box(0.09, 0.05, 0.014, center=(0, 0, -0.018)),
        ]),
        Shape.from_hulls("mallet", [
            box(0.10, 0.024, 0.024),
            box(0.03, 0.064, 0.034, center=(0.065, 0, 0)),
        ]),
        Shape.from_hulls("hexagon_nut", wall((0.014, 0.034, 0), (0.014, 0.034, 0.03), pieces=6)),
        Shape.from_hulls(
            "light_bulb",
            turned(
                (0.013, 0), (0.013, 0.022), (0.028, 0.045), (0.030, 0.056), (0.024, 0.073),
                (0.010, 0.082),
            ),
            rolls=True,
        ),
        Shape.from_hulls("mug", [
            cylinder(0.034, 0, 0.01),
            *wall((0.025, 0.034, 0.01), (0.025, 0.034, 0.07)),
            box(0.018, 0.012, 0.012, center=(0.042, 0, 0.054)),
            box(0.018, 0.012, 0.012, center=(0.042, 0, 0.022)),
            box(0.010, 0.012, 0.044, center=(0.056, 0, 0.038)),
        ], rolls=True),
        Shape.from_hulls("octahedron", [0.04 * np.vstack([np.eye(3), -np.eye(3)])]),
        Shape.from_hulls("pyramid", [np.array([
            *((x, y, 0) for x in (-0.032, 0.032) for y in (-0.032, 0.032)), (0, 0, 0.055),
        ])]),
        Shape.from_hulls("ring", wall((0.020, 0.037, 0), (0.020, 0.037, 0.028))),
        Shape.from_hulls(
            "spool",
            turned((0.032, 0), (0.032, 0.014)) + turned((0.017, 0.014), (0.017, 0.046))
            + turned((0.032, 0.046), (0.032, 0.06)),
            rolls=True,
        ),
        Shape.from_hulls("stairs", [
            box(0.03, 0.05, 0.02 * (step + 1), center=(0.03 * step, 0, 0.01 * (step + 1)))
            for step in range(3)
        ]),
        Shape.from_hulls("star", _star(5, 0.045, 0.026, 0.03)),
        Shape.from_hulls("tee", [
            box(0.09, 0.03, 0.03),
            box(0.03, 0.05, 0.03, center=(0, 0.04, 0)),
        ]),
        Shape.from_hulls("wedge", [upright([(0, 0), (0.085, 0), (0.085, 0.045)], 0.05)]),
    )
}  # fmt: skip
"""Two dozen things by name."""
