"""The references do the same work as what they are compared with."""

from __future__ import annotations

import numpy as np
from closed_form import HD, Box, Plane, look, looking_at

from policies.heightmap import SIZE, Workspace
from tdpg_deploy.geometry import Transform
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.sim.bodies import box
from tdpg_deploy.sim.camera import COLOR_640
from tdpg_deploy.sim.pieces import ConvexPiece, VisiblePiece
from tdpg_deploy.sim.render import render
from tools.benchmark.perception import scatter_in_numpy, tiny_renderer

EYE = looking_at((0.8, 0.1, 0.55), (0.5, 0.0, -0.15))
BLOCK = Box(
    size=(0.06, 0.05, 0.04),
    X_base_box=Transform.from_quaternion((0.52, 0.03, -0.13), (0, 0, 0.2, 0.98)),
)


def test_the_plain_scatter_makes_the_same_map() -> None:
    frame = look(Plane(normal=(0, 0, 1), offset=-0.15), BLOCK, HD, EYE)
    workspace = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)
    height, color = scatter_in_numpy(frame, EYE, workspace)
    heightmap = build_heightmap(frame, EYE, workspace)
    seen = np.isfinite(height).reshape(SIZE, SIZE)
    agree = np.abs(height.reshape(SIZE, SIZE) - heightmap.height)[seen] < 1e-4
    assert agree.mean() > 0.999
    assert (color.reshape(SIZE, SIZE, 3) == heightmap.color)[seen].mean() > 0.995


def test_tiny_renderer_sees_the_same_pieces() -> None:
    table = ConvexPiece.from_vertices(box(2, 2, 0.1, center=(0.5, 0, -0.2)))
    block = ConvexPiece.from_vertices(box(*BLOCK.size))
    pieces = [
        VisiblePiece(table, Transform.identity(), (200, 180, 150), 0),
        VisiblePiece(block, BLOCK.X_base_box, (200, 40, 40), 1),
    ]
    with tiny_renderer(pieces, COLOR_640, EYE) as draw:
        tiny = draw()
    owner = render(pieces, COLOR_640, EYE).owner
    assert (tiny == 1).sum() > 500
    # pybullet's picture has its centre in the middle, a few pixels beside the lens's.
    assert (tiny[owner >= 0] == owner[owner >= 0]).mean() > 0.98
