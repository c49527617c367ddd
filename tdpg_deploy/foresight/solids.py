"""Things that a heightmap shows, as solids that a simulated world can hold."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError
from scipy.spatial.transform import Rotation

from policies.heightmap import Heightmap
from policies.standing import Map, Mask
from tdpg_deploy.foresight.rectangles import rectangle
from tdpg_deploy.foresight.things import things
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.sim.bodies import Shape, extrude
from tdpg_deploy.sim.scenes import Scene, SceneObject

INSET = 0.0005  # m by which outlines are drawn in: a map shows the highest point in each pixel
RIM = 0.006  # m below a flat top, where it ends: the side that faces the camera is seen, too
FLAT = 0.85  # share of a thing's pixels that lie no deeper than that, if it is flat
FOOT = 0.5  # share of another thing's height below which its pixels are the blur of its border
THINNEST = 0.012  # m
_NOISE = np.ones((3, 3), np.uint8)


def scene_shown(heightmap: Heightmap) -> Scene:
    """One upright prism on the table for each thing: the convex hull of its outline, as high as
    most of it. What is hidden, hollow, round or leans is none the less a prism."""
    return Scene(objects=tuple(_solids(heightmap)))


def _solids(heightmap: Heightmap) -> Iterator[SceneObject]:
    found, workspace = things(heightmap), heightmap.workspace
    for thing in np.unique(found[found > 0]).tolist():
        shown = found == thing
        height = float(np.median(heightmap.height[shown]))
        red, green, blue = np.median(heightmap.color[shown], axis=0)
        outline = _outline(_top(shown, heightmap.height, height), heightmap)
        if outline is None:
            continue
        bottom, height = workspace.table_z, max(height, THINNEST)
        prism = extrude(outline, bottom, bottom + height)
        shape = Shape.from_hulls(f"thing {thing}", [prism])
        center = prism[0] - shape.vertices[0]
        if workspace.contains(center[0], center[1]):
            yield SceneObject(
                shape=shape,
                X_base_object=Transform(Rotation.identity(), center),
                rgb=(int(red), int(green), int(blue)),
                goal=heightmap.goal is not None and bool(heightmap.goal[shown].all()),
            )


def _top(shown: Mask, height: Map, most: float) -> Mask:
    """Pixels of a thing, `most` of which stand at this height, without the sides of it."""
    foot = shown & (height > FOOT * most)
    rim = shown & (height > most - RIM)
    top = rim if rim.sum() >= FLAT * foot.sum() else foot
    opened: Mask = cv2.morphologyEx(top.astype(np.uint8), cv2.MORPH_OPEN, _NOISE) > 0
    return opened


def _outline(top: Mask, heightmap: Heightmap) -> Array | None:
    """(n, 2) x, y in base of the corners of a convex outline; None of what is too small for one."""
    rows, cols = np.nonzero(top)
    if not len(rows):
        return None
    corners = rectangle(top)
    if corners is not None:
        cols, rows = corners.T
    points = np.column_stack(heightmap.workspace.to_base(rows, cols))
    try:
        planes = ConvexHull(points).equations + np.array([0, 0, INSET])
        drawn_in = HalfspaceIntersection(planes, points.mean(axis=0)).intersections
        outline: Array = drawn_in[ConvexHull(drawn_in).vertices]
    except (QhullError, ValueError):  # hardly a pixel wide
        return None
    return outline
