"""Where the gripper comes down, and what the heightmap knows of the ground there. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from policies.gripper import Part
from policies.heightmap import RIM, WIDE, Heightmap
from policies.primitives import Primitive
from tdpg_deploy.geometry import Array

_SPACING = 0.001  # m between samples: half a pixel, so that none is missed
_UPPER_END = 0.95  # a stereo camera's edges fly


@dataclass(frozen=True, kw_only=True)
class Rectangle:
    """On the table, seen from above: centre in base (m), sides (m) along and across `yaw`."""

    x: float
    y: float
    yaw: float
    along: float
    across: float

    def points(self) -> tuple[Array, Array]:
        """x, y in base (n,) of a grid that covers it, border included."""
        u, v = np.meshgrid(_grid(self.along), _grid(self.across))
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return (self.x + c * u - s * v).ravel(), (self.y + s * u + c * v).ravel()


def _grid(side: float) -> Array:
    count = max(2, int(np.ceil(side / _SPACING)) + 1)
    return np.linspace(-side / 2, side / 2, count, dtype=np.float64)


def rectangles(part: Part, primitive: Primitive) -> tuple[Rectangle, ...]:
    """Where a part of the gripper comes down for an action: one place or two."""
    c, s = np.cos(primitive.yaw), np.sin(primitive.yaw)
    return tuple(
        Rectangle(
            x=primitive.x + offset * c,
            y=primitive.y + offset * s,
            yaw=primitive.yaw,
            along=part.along,
            across=part.across,
        )
        for offset in ((part.apart / 2, -part.apart / 2) if part.apart else (0.0,))
    )


@dataclass(frozen=True, kw_only=True)
class Ground:
    """highest: metres above the table, of what was seen but for outliers; nan when nothing was.
    unknown: share of the rectangle that was not seen, or lies beyond the known surroundings.
    """

    highest: float
    unknown: float


def ground_under(heightmap: Heightmap, rectangle: Rectangle, *, clear_margin: float) -> Ground:
    """What was not seen is unknown; but for `clear_margin` metres around the map it is table: the
    cell's owner vouches for it."""
    x, y = rectangle.points()
    workspace = heightmap.workspace
    row, col = workspace.to_pixel(x, y)
    row, col = row + RIM, col + RIM
    looked_at = (row >= 0) & (row < WIDE) & (col >= 0) & (col < WIDE)
    height: npt.NDArray[np.float32] = np.full(len(x), np.nan, np.float32)
    height[looked_at] = heightmap.wide[row[looked_at], col[looked_at]]
    middle = workspace.middle
    beyond = np.maximum(abs(x - middle[0]), abs(y - middle[1])) - workspace.side / 2
    height[np.isnan(height) & (beyond > 0) & (beyond <= clear_margin)] = 0.0
    seen = np.isfinite(height)
    highest = float(np.quantile(height[seen], _UPPER_END)) if seen.any() else float("nan")
    return Ground(highest=highest, unknown=1.0 - float(seen.mean()))
