"""What stands still in the cell: table, plinth, bin, floor. Vertices in base, metres."""

from __future__ import annotations

from policies.heightmap import Workspace
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.sim.bodies import box
from tdpg_deploy.sim.pieces import BIN, ROBOT, TABLE, ConvexPiece, VisiblePiece

TABLE_RIM = 0.126  # m of table around the workspace
TABLE_THICKNESS = 0.10
FLOOR_DEPTH = 0.75  # m from the table's surface down to the floor
BIN_SIDE = 0.26  # m, inside
BIN_DEPTH = 0.20  # m below the table's surface
BIN_WALL = 0.02

WOOD = (196, 178, 152)
CONCRETE = (112, 112, 110)
STEEL = (140, 144, 150)
PLASTIC = (60, 84, 120)


def furnish(config: CellConfig, workspace: Workspace) -> list[VisiblePiece]:
    """The standing pieces, table first."""
    x, y = config.workspace.center
    top = workspace.table_z
    floor = top - FLOOR_DEPTH
    side = workspace.side + 2 * TABLE_RIM
    plinth = max(-floor, 0.01)
    return [
        _piece(side, side, TABLE_THICKNESS, (x, y, top - TABLE_THICKNESS / 2), WOOD, TABLE),
        _piece(4.0, 4.0, 0.2, (0, 0, floor - 0.1), CONCRETE, TABLE),
        _piece(0.18, 0.18, plinth, (0, 0, -plinth / 2), STEEL, ROBOT),
        *_bin(config.bin.position[0], config.bin.position[1], top),
    ]


def _bin(x: float, y: float, top: float) -> list[VisiblePiece]:
    """Open box: a floor and four walls, the walls as high as the table."""
    half, wall, depth = BIN_SIDE / 2, BIN_WALL, BIN_DEPTH
    out = BIN_SIDE + 2 * wall
    middle = top - depth / 2
    offset = half + wall / 2
    return [
        _piece(out, out, 0.05, (x, y, top - depth - 0.025), PLASTIC, BIN),
        _piece(wall, out, depth, (x - offset, y, middle), PLASTIC, BIN),
        _piece(wall, out, depth, (x + offset, y, middle), PLASTIC, BIN),
        _piece(BIN_SIDE, wall, depth, (x, y - offset, middle), PLASTIC, BIN),
        _piece(BIN_SIDE, wall, depth, (x, y + offset, middle), PLASTIC, BIN),
    ]


def in_bin(config: CellConfig, p_base: Array) -> bool:
    """Whether a point lies between the bin's walls, or heaped up to a hand above them."""
    x, y, _ = config.bin.position
    depth = config.workspace.table_z - p_base[2]
    return bool(
        abs(p_base[0] - x) < BIN_SIDE / 2
        and abs(p_base[1] - y) < BIN_SIDE / 2
        and -0.05 < depth < BIN_DEPTH + 0.01
    )


def _piece(
    x: float,
    y: float,
    z: float,
    center: tuple[float, float, float],
    rgb: tuple[int, int, int],
    owner: int,
) -> VisiblePiece:
    piece = ConvexPiece.from_vertices(box(x, y, z, center=center))
    return VisiblePiece(piece, Transform.identity(), rgb, owner)
