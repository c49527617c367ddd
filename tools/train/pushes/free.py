"""Which objects a gripper could take now, by the rules that policies grasp by."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from policies.heightmap import PIXEL, SIZE, Heightmap, Workspace
from policies.masks import sure_grasps
from tdpg_deploy.cell import Cell
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Intrinsics
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.sim.pieces import VisiblePiece
from tdpg_deploy.sim.render import render
from tdpg_deploy.sim.world import Where, World
from tdpg_deploy.workspace import workspace_of
from tools.goals import detector_of

Owners = npt.NDArray[np.int8]  # (224, 224): the object that each pixel shows, -1 where none
Flags = npt.NDArray[np.bool_]  # (objects,)

GRASPS = 10  # pixels and rotations: so many sure grasps show an object to be free
FAR = 20.0  # m above the table: from there all is seen straight from above


def free(heightmap: Heightmap, owners: Owners, objects: int) -> Flags:
    """Whether there are sure grasps on each object."""
    sure = sure_grasps(heightmap, owners >= 0)
    counts = np.bincount(np.broadcast_to(owners, sure.shape)[sure], minlength=objects)
    enough: Flags = counts >= GRASPS
    return enough


def look(cell: Cell) -> tuple[Heightmap, Owners]:
    """What the camera shows, and which object each pixel of it is of."""
    config, frame = cell.config, cell.camera.capture()
    numbers = np.zeros_like(frame.color)
    numbers[..., 0] = detector_of(cell).owner(frame).clip(-1) + 1
    numbered = dataclasses.replace(frame, color=numbers)
    workspace = workspace_of(config)
    owners = build_heightmap(numbered, config.X_base_camera, workspace).color[..., 0]
    return (
        build_heightmap(frame, config.X_base_camera, workspace),
        (owners.astype(np.int16) - 1).astype(np.int8),
    )


def on_table(world: World) -> Flags:
    """Which of the scene's objects lie in the workspace."""
    return np.array([state.where is Where.WORKSPACE for state in world.objects()])


def taken_by_grasps(world: World) -> Flags:
    """Which objects come away when all that are free are taken, and again, until none is: those
    that need no push. Seen from straight above, by the simulator's truth."""
    pieces = [piece for piece in world.visible() if piece.owner >= 0]
    left = on_table(world)
    taken = np.zeros_like(left)
    while left.any():
        heightmap, owners = _from_above(
            [piece for piece in pieces if left[piece.owner]], world.workspace
        )
        came = free(heightmap, owners, len(left))
        if not came.any():
            break
        left &= ~came
        taken |= came
    return taken


def _from_above(pieces: list[VisiblePiece], workspace: Workspace) -> tuple[Heightmap, Owners]:
    """The heightmap that a perfect camera high above would give."""
    down = Rotation.from_matrix([[0, -1, 0], [-1, 0, 0], [0, 0, -1]])  # its rows are the map's
    eye = np.array([*workspace.middle, workspace.table_z + FAR])
    middle = (SIZE - 1) / 2
    lens = Intrinsics(width=SIZE, height=SIZE, fx=FAR / PIXEL, fy=FAR / PIXEL, cx=middle, cy=middle)
    seen = render(pieces, lens, Transform(down, eye))
    height = np.nan_to_num(FAR - seen.depth, nan=0.0).clip(0).astype(np.float32)
    heightmap = Heightmap(
        workspace=workspace, color=np.zeros((SIZE, SIZE, 3), np.uint8), height=height
    )
    return heightmap, np.where(seen.owner < 0, -1, seen.owner).astype(np.int8)
