"""How long it takes to make a heightmap of a D435's frame, and to render that frame.

References, measured in the same run: a plain scatter in NumPy, and pybullet's TinyRenderer on
the same world.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import numpy.typing as npt
import pybullet
from scipy.spatial import ConvexHull

from policies.heightmap import PIXEL, SIZE, Workspace
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics, RgbdFrame
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.sim.camera import COLOR_640, COLOR_1280, SimCamera, true_pose
from tdpg_deploy.sim.depth_noise import with_stereo_noise
from tdpg_deploy.sim.pieces import VisiblePiece
from tdpg_deploy.sim.render import render
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.sim.world import World
from tdpg_deploy.workspace import workspace_of
from tools.benchmark.measure import Measurement, timed

OBJECTS = 30
REPEATS = 50


def run() -> list[Measurement]:
    """Milliseconds a frame, on a table with thirty objects."""
    results = []
    for width in (640, 1280):
        with crowded_world(width) as world:
            results += of_frames(world, width) + of_rendering(world, width)
    return results


@contextmanager
def crowded_world(width: int) -> Iterator[World]:
    config = load_cell(DEFAULT_CELL)
    config = config.model_copy(update={"camera": config.camera.model_copy(update={"width": width})})
    scene = random_scene(OBJECTS, workspace_of(config), np.random.default_rng(0))
    world = World(config, scene, seed=0)
    try:
        yield world
    finally:
        world.close()


def of_frames(world: World, width: int) -> list[Measurement]:
    camera = SimCamera(world, world.config)
    camera.connect()
    frame, X_base_camera = camera.capture(), world.config.X_base_camera
    scatter = timed(
        f"heightmap of {width}: NumPy scatter",
        partial(scatter_in_numpy, frame, X_base_camera, world.workspace),
        repeats=REPEATS // 2,
    )
    return [
        scatter,
        timed(
            f"heightmap of {width}: build_heightmap",
            partial(build_heightmap, frame, X_base_camera, world.workspace),
            repeats=REPEATS,
            reference=scatter.median,
        ),
    ]


def of_rendering(world: World, width: int) -> list[Measurement]:
    intrinsics = {640: COLOR_640, 1280: COLOR_1280}[width]
    pieces, X_base_camera = world.visible(), true_pose(world.config)
    seen = render(pieces, intrinsics, X_base_camera)
    with tiny_renderer(pieces, intrinsics, X_base_camera) as draw:
        tiny = timed(f"render {width}: TinyRenderer", draw, repeats=REPEATS // 5)
    return [
        tiny,
        timed(
            f"render {width}: render",
            partial(render, pieces, intrinsics, X_base_camera),
            repeats=REPEATS,
            reference=tiny.median,
        ),
        timed(
            f"noise of {width}: with_stereo_noise",
            partial(
                with_stereo_noise, seen.depth, seen.color, intrinsics, np.random.default_rng(0)
            ),
            repeats=REPEATS,
        ),
    ]


def scatter_in_numpy(
    frame: RgbdFrame, X_base_camera: Transform, workspace: Workspace
) -> tuple[Array, npt.NDArray[np.uint8]]:
    """Height and colour (50176, ...) as one would write them in plain NumPy."""
    k = frame.intrinsics
    row, col = np.nonzero(np.isfinite(frame.depth))
    z = frame.depth[row, col]
    p_camera = np.stack([(col - k.cx) / k.fx * z, (row - k.cy) / k.fy * z, z], axis=-1)
    x, y, up = (X_base_camera @ p_camera).T
    i = np.floor((workspace.x_max - x) / PIXEL).astype(int)
    j = np.floor((workspace.y_max - y) / PIXEL).astype(int)
    inside = (i >= 0) & (i < SIZE) & (j >= 0) & (j < SIZE)
    place, up, rgb = (i * SIZE + j)[inside], up[inside], frame.color[row, col][inside]
    height = np.full(SIZE * SIZE, -np.inf)
    np.maximum.at(height, place, up)
    color = np.zeros((SIZE * SIZE, 3), np.uint8)
    highest = up == height[place]
    color[place[highest]] = rgb[highest]
    return height - workspace.table_z, color


@contextmanager
def tiny_renderer(
    pieces: list[VisiblePiece], k: Intrinsics, X_base_camera: Transform
) -> Iterator[Callable[[], npt.NDArray[np.int_]]]:
    """A call that draws the same pieces from the same place with pybullet on the CPU, and gives
    the index of the piece that each pixel sees (-1: none)."""
    client = pybullet.connect(pybullet.DIRECT)
    for item in pieces:
        hull = ConvexHull(item.piece.vertices)
        a, b, c = (hull.points[hull.simplices[:, corner]] for corner in range(3))
        outwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) > 0
        triangles = np.where(outwards[:, None], hull.simplices, hull.simplices[:, ::-1])
        pybullet.createMultiBody(
            0,
            -1,
            pybullet.createVisualShape(
                pybullet.GEOM_MESH,
                vertices=hull.points.tolist(),
                indices=triangles.ravel().tolist(),
                physicsClientId=client,
            ),
            item.X_base_piece.translation.tolist(),
            item.X_base_piece.rotation.as_quat().tolist(),
            physicsClientId=client,
        )
    _, down, forward = X_base_camera.rotation.as_matrix().T
    eye = X_base_camera.translation
    view = pybullet.computeViewMatrix(eye.tolist(), (eye + forward).tolist(), (-down).tolist())
    field_of_view = float(np.degrees(2 * np.arctan(k.height / 2 / k.fy)))
    lens = pybullet.computeProjectionMatrixFOV(field_of_view, k.width / k.height, 0.1, 5.0)

    def draw() -> npt.NDArray[np.int_]:
        image = pybullet.getCameraImage(
            k.width,
            k.height,
            view,
            lens,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=client,
        )
        return np.asarray(image[4])

    try:
        yield draw
    finally:
        pybullet.disconnect(client)
