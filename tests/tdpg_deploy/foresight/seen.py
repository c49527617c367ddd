"""Blocks on the mock cell's table, and what its camera shows of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from policies.heightmap import Heightmap
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.geometry import Transform
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.hurry import in_a_hurry
from tdpg_deploy.sim.scenes import PALETTE, Scene, SceneObject
from tdpg_deploy.workspace import workspace_of
from tools.train.pushes.free import look

CONFIG = in_a_hurry(load_cell(DEFAULT_CELL))
TABLE_Z = workspace_of(CONFIG).table_z


@dataclass(frozen=True)
class Seen:
    """owners: (224, 224) which of the scene's objects each pixel shows, -1 where none."""

    scene: Scene
    heightmap: Heightmap
    owners: npt.NDArray[np.int8]


def block(name: str, x: float, y: float, yaw: float = 0.0, *, goal: bool = False) -> SceneObject:
    """As it was built, on the table."""
    shape, turn = SHAPES[name], Rotation.from_euler("z", yaw)
    position = np.array([x, y, TABLE_Z - shape.vertices[:, 2].min()])
    rgb = PALETTE[round(100 * (x + y)) % len(PALETTE)]
    return SceneObject(shape=shape, X_base_object=Transform(turn, position), rgb=rgb, goal=goal)


def seen(scene: Scene) -> Seen:
    with open_cell(CONFIG, scene=scene) as cell:
        heightmap, owners = look(cell)
    goals = [index for index, item in enumerate(scene.objects) if item.goal]
    if goals:
        heightmap = replace(heightmap, goal=owners == goals[0])
    return Seen(scene, heightmap, owners)


def row_of_bars() -> Scene:
    """Three side by side along x, the goal in the middle: no finger fits between them."""
    return Scene(
        objects=(
            block("bar", 0.5, 0.0505),
            block("bar", 0.5, 0.0, goal=True),
            block("bar", 0.5, -0.0505),
        )
    )
