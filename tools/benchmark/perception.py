"""How long it takes to make a heightmap of a D435's frame, and to render that frame.

References, measured in the same run: a plain scatter in NumPy, and pybullet's TinyRenderer on
the same world.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import pybullet

from policies.heightmap import PIXEL, SIZE, Workspace
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import RgbdFrame
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.sim.camera import COLOR_640, COLOR_1280, SimCamera, true_pose
from tdpg_deploy.sim.depth_noise import with_stereo_noise
from tdpg_deploy.sim.render import render
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.sim.world import World
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
    workspace = Workspace.around(config.workspace.center, config.workspace.table_z)
    scene = random_scene(OBJECTS, workspace, np.random.default_rng(0))
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
    tiny = timed(
        f"render {width}: TinyRenderer",
        partial(draw_with_tiny_renderer, world, width),
        repeats=max(3, REPEATS // 10),
    )
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
) -> tuple[Array, Array]:
    """Height and colour as most would write them: points in order of height, the last one wins."""
    k = frame.intrinsics
    row, col = np.mgrid[: k.height, : k.width]
    z = frame.depth
    p_camera = np.stack([(col - k.cx) / k.fx * z, (row - k.cy) / k.fy * z, z], axis=-1)
    p_base = X_base_camera @ p_camera[np.isfinite(z)]
    colors = frame.color[np.isfinite(z)]
    i = np.floor((workspace.x_max - p_base[:, 0]) / PIXEL).astype(int)
    j = np.floor((workspace.y_max - p_base[:, 1]) / PIXEL).astype(int)
    inside = (i >= 0) & (i < SIZE) & (j >= 0) & (j < SIZE)
    i, j, up, colors = i[inside], j[inside], p_base[inside, 2], colors[inside]
    order = np.argsort(up)
    height = np.full((SIZE, SIZE), np.nan)
    color = np.zeros((SIZE, SIZE, 3))
    height[i[order], j[order]] = up[order] - workspace.table_z
    color[i[order], j[order]] = colors[order]
    return height, color


def draw_with_tiny_renderer(world: World, width: int) -> None:
    """The same view of the physics' own shapes."""
    k = {640: COLOR_640, 1280: COLOR_1280}[width]
    pose = true_pose(world.config)
    _, down, forward = pose.rotation.as_matrix().T
    eye = pose.translation
    view = pybullet.computeViewMatrix(eye.tolist(), (eye + forward).tolist(), (-down).tolist())
    field_of_view = float(np.degrees(2 * np.arctan(k.height / 2 / k.fy)))
    projection = pybullet.computeProjectionMatrixFOV(field_of_view, k.width / k.height, 0.1, 5.0)
    pybullet.getCameraImage(
        k.width,
        k.height,
        view,
        projection,
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=world.client,
    )
