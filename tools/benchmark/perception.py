"""How long it takes until a frame is a heightmap, and how long the simulated camera takes for one.

References of the same run: a plain NumPy scatter of the same points, and pybullet's TinyRenderer
on the same bodies.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt
import pybullet

from policies.heightmap import SIZE, Workspace
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Intrinsics, RgbdFrame
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.sim.camera import SimCamera
from tdpg_deploy.sim.render import Lighting, render
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.sim.world import World
from tdpg_deploy.workspace import workspace_of
from tools.benchmark.measure import Measurement, timed

OBJECTS = 10
REPEATS = 50
REFERENCE_REPEATS = 7


def run() -> list[Measurement]:
    """Milliseconds a frame, at both sizes of the camera, with ten objects on the table."""
    return [measurement for width in (640, 1280) for measurement in _at_width(width)]


def _at_width(width: int) -> list[Measurement]:
    config = load_cell(DEFAULT_CELL)
    camera_section = config.camera.model_copy(update={"width": width})
    config = config.model_copy(update={"camera": camera_section})
    workspace = workspace_of(config)
    scene = random_scene(OBJECTS, workspace, np.random.default_rng(0))
    world = World(config, scene, seed=0)
    try:
        camera = SimCamera(world, config)
        camera.connect()
        frame = camera.capture()
        return [
            *_heightmap(frame, config.X_base_camera, workspace),
            *_rendering(world, config, frame.intrinsics),
            timed(f"{_size(frame.intrinsics)}: capture with noise", camera.capture, repeats=15),
        ]
    finally:
        world.close()


def _heightmap(
    frame: RgbdFrame, X_base_camera: Transform, workspace: Workspace
) -> list[Measurement]:
    size = _size(frame.intrinsics)
    scatter = timed(
        f"{size}: heightmap, NumPy scatter",
        partial(numpy_scatter, frame, X_base_camera, workspace),
        repeats=REFERENCE_REPEATS,
    )
    ours = timed(
        f"{size}: heightmap",
        partial(build_heightmap, frame, X_base_camera, workspace),
        repeats=REPEATS,
        reference=scatter.median,
    )
    return [scatter, ours]


def numpy_scatter(
    frame: RgbdFrame, X_base_camera: Transform, workspace: Workspace
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """Colour and height of the highest point in each pixel, without filling: points are sorted
    by height, so that the highest one is written last."""
    k = frame.intrinsics
    row, col = np.nonzero(np.isfinite(frame.depth))
    z = frame.depth[row, col]
    p_camera = np.stack([(col - k.cx) / k.fx * z, (row - k.cy) / k.fy * z, z], axis=1)
    p_base = X_base_camera @ p_camera
    order = np.argsort(p_base[:, 2])
    i, j = workspace.to_pixel(p_base[order, 0], p_base[order, 1])
    inside = (i >= 0) & (i < SIZE) & (j >= 0) & (j < SIZE)
    i, j, order = i[inside], j[inside], order[inside]
    height = np.full((SIZE, SIZE), np.nan, np.float32)
    color = np.zeros((SIZE, SIZE, 3), np.uint8)
    height[i, j] = p_base[order, 2] - workspace.table_z
    color[i, j] = frame.color[row[order], col[order]]
    return color, height


def _rendering(world: World, config: CellConfig, intrinsics: Intrinsics) -> list[Measurement]:
    size, pieces = _size(intrinsics), world.visible()
    X_base_camera = config.X_base_camera
    tiny = timed(
        f"{size}: picture, TinyRenderer",
        partial(tiny_renderer, world, intrinsics, X_base_camera),
        repeats=REFERENCE_REPEATS,
    )
    ours = [
        timed(
            f"{size}: picture{how}",
            partial(render, pieces, intrinsics, X_base_camera, lighting),
            repeats=REPEATS // 2,
            reference=tiny.median,
        )
        for how, lighting in (("", Lighting()), (" with shadows", Lighting(shadow_side=1.0)))
    ]
    return [tiny, *ours]


def tiny_renderer(world: World, intrinsics: Intrinsics, X_base_camera: Transform) -> object:
    """Colour, depth and owners by pybullet's software renderer, without shadows."""
    k, near, far = intrinsics, 0.05, 5.0
    to_opengl = np.diag([1.0, -1.0, -1.0, 1.0])  # its camera looks along -z, y up
    view = to_opengl @ X_base_camera.inverse().as_matrix()
    projection = np.array(
        [
            [2 * k.fx / k.width, 0, 1 - 2 * k.cx / k.width, 0],
            [0, 2 * k.fy / k.height, 2 * k.cy / k.height - 1, 0],
            [0, 0, (near + far) / (near - far), 2 * near * far / (near - far)],
            [0, 0, -1, 0],
        ]
    )
    picture: object = pybullet.getCameraImage(
        k.width,
        k.height,
        view.T.ravel().tolist(),
        projection.T.ravel().tolist(),
        shadow=0,
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=world.client,
    )
    return picture


def _size(intrinsics: Intrinsics) -> str:
    return f"{intrinsics.width}x{intrinsics.height}"
