"""The square that the cell file names, as heightmaps know it."""

from __future__ import annotations

from policies.heightmap import PIXEL, SIZE, Workspace
from tdpg_deploy.cell_config import CellConfig


def workspace_of(config: CellConfig) -> Workspace:
    x, y = config.workspace.center
    half = SIZE * PIXEL / 2
    return Workspace(x_min=x - half, y_min=y - half, table_z=config.workspace.table_z)
