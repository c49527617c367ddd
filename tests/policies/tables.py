"""Tables to look at: heightmaps with blocks of known size."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from policies.heightmap import SIZE, Heightmap, Workspace

WORKSPACE = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)


def table_with(
    *blocks: tuple[int, int, int, int, float], goal: npt.NDArray[np.bool_] | None = None
) -> Heightmap:
    """Blocks (row, col, rows, cols in pixels, height in m) on an empty table."""
    height = np.zeros((SIZE, SIZE), np.float32)
    color = np.full((SIZE, SIZE, 3), 90, np.uint8)
    for row, col, rows, cols, top in blocks:
        height[row : row + rows, col : col + cols] = top
        color[row : row + rows, col : col + cols] = (200, 60, 30)
    return Heightmap(workspace=WORKSPACE, color=color, height=height, goal=goal)


def goal_at(rows: slice, cols: slice) -> npt.NDArray[np.bool_]:
    """Pixels that show the goal."""
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[rows, cols] = True
    return goal
