"""Four tags glued to the simulated table: paper that a camera sees, and nothing touches."""

from __future__ import annotations

from itertools import product

import numpy as np

from policies.heightmap import Workspace
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.markers import TAG_COUNT, TAG_SIDE, marker_rectangles, table_tags
from tdpg_deploy.sim.bodies import box
from tdpg_deploy.sim.furniture import TABLE_RIM
from tdpg_deploy.sim.pieces import TABLE, ConvexPiece, VisiblePiece

WHITE_MARGIN = 0.006  # m of paper around a tag
PAPER_THICKNESS, INK_THICKNESS = 0.2e-3, 0.1e-3
ALONG = 0.15  # m from the workspace's middle, in x
PAPER, INK = (235, 235, 235), (28, 28, 28)


def lay_tags(workspace: Workspace) -> list[VisiblePiece]:
    """On the rim left and right of the workspace, two each, flat on the table."""
    x_middle = (workspace.x_min + workspace.x_max) / 2
    beside = TABLE_RIM / 2
    middles = product(
        (x_middle - ALONG, x_middle + ALONG), (workspace.y_min - beside, workspace.y_max + beside)
    )
    pieces = []
    for number, middle in zip(range(TAG_COUNT), middles, strict=True):
        pieces += _tag(number, middle, workspace.table_z)
    return pieces


def _tag(number: int, middle: tuple[float, float], table_z: float) -> list[VisiblePiece]:
    half = TAG_SIDE / 2 + WHITE_MARGIN
    dark = marker_rectangles(table_tags(), number, TAG_SIDE, [-TAG_SIDE / 2, -TAG_SIDE / 2])
    sheet = _flat(np.array([-half, -half, half, half]), middle, table_z, PAPER_THICKNESS, PAPER)
    ink = PAPER_THICKNESS + INK_THICKNESS
    return [sheet, *(_flat(rectangle, middle, table_z, ink, INK) for rectangle in dark)]


def _flat(
    rectangle: Array,
    middle: tuple[float, float],
    table_z: float,
    height: float,
    rgb: tuple[int, int, int],
) -> VisiblePiece:
    """x0, y0, x1, y1 around `middle`, y down as on paper seen from above; base's y goes up."""
    x0, y0, x1, y1 = (float(value) for value in rectangle)
    center = (middle[0] + (x0 + x1) / 2, middle[1] - (y0 + y1) / 2, table_z + height / 2)
    piece = ConvexPiece.from_vertices(box(x1 - x0, y1 - y0, height, center=center))
    return VisiblePiece(piece, Transform.identity(), rgb, TABLE)
