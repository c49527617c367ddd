"""A heightmap -> a scene of boxes that looks like it. A guess: what a camera above does not see,
whether a block overhangs or two of them touch, it cannot tell. Pure.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial.transform import Rotation

from policies.heightmap import PIXEL, Heightmap
from policies.standing import rising
from tdpg_deploy.geometry import Transform
from tdpg_deploy.sim.bodies import Shape, box
from tdpg_deploy.sim.scenes import MAX_OBJECTS, Scene, SceneObject

EDGE = 0.006  # m between neighbouring pixels: another surface; a slope of 70 deg is none yet
SMALLEST = 60  # pixels, 240 mm^2; the smallest face of a block has 312
GAP = 0.001  # m between boxes that touch, so that they do not push each other apart

Mask = npt.NDArray[np.bool_]


def fit_boxes(heightmap: Heightmap) -> Scene:
    """An upright box under each surface that rises above the table, down to the table."""
    labels, count = ndimage.label(_without_edges(heightmap))
    surfaces = [labels == label for label in range(1, count + 1)]
    large = sorted((s for s in surfaces if s.sum() >= SMALLEST), key=lambda s: -int(s.sum()))
    return Scene(
        objects=tuple(_box(heightmap, surface, i) for i, surface in enumerate(large[:MAX_OBJECTS]))
    )


def _without_edges(heightmap: Heightmap) -> Mask:
    """What rises, cut where one surface ends above another."""
    high = rising(heightmap)
    height = np.where(high, heightmap.height, np.nan)
    cut = np.zeros_like(high)
    with np.errstate(invalid="ignore"):
        cut[1:] |= np.abs(height[1:] - height[:-1]) > EDGE
        cut[:, 1:] |= np.abs(height[:, 1:] - height[:, :-1]) > EDGE
    return np.asarray(high & ~cut)


def _box(heightmap: Heightmap, surface: Mask, index: int) -> SceneObject:
    x, y = heightmap.workspace.to_base(*np.nonzero(surface))
    points = np.stack([x, y], axis=-1).astype(np.float32)
    (x_mid, y_mid), sides, degrees = cv2.minAreaRect(points)
    length, width = (max(side + PIXEL - GAP, GAP) for side in sides)
    height = float(np.median(heightmap.height[surface]))
    center = np.array([x_mid, y_mid, heightmap.workspace.table_z + height / 2])
    red, green, blue = (int(value) for value in heightmap.color[surface].mean(axis=0))
    return SceneObject(
        shape=Shape.from_hulls(f"box {index}", [box(length, width, height)]),
        X_base_object=Transform(Rotation.from_euler("z", degrees, degrees=True), center),
        rgb=(red, green, blue),
    )
