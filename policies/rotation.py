"""Turn the map so that an action points up, and bring its values back.

For rotation k the picture shows the workspace turned by -k * pi / 8: what lies in the action's
direction, yaw = k * pi / 8, lies above the pixel. A picture is FRAME pixels wide, so that every
rotation of the map fits; what is not workspace is zero.

Pictures take the nearest pixel of the map: a mean of table and block is the height of neither.
Values come back by bilinear interpolation at the exact place, so a pixel of the map and its
place in the picture are two names of one action. Positions in pictures are (x, y) in [-1, 1]
from border to border, `grid_sample`'s convention, and so hold for every stride of a network.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F

from policies.heightmap import SIZE
from policies.policy import ROTATIONS

FRAME = 320  # pixels; 224 * sqrt(2) = 316.8, rounded up to the networks' stride of 32
_VOID = SIZE * SIZE  # index of the row of zeros behind the last pixel

_YAW = np.arange(ROTATIONS) * (2 * np.pi / ROTATIONS)
_COS = torch.from_numpy(np.cos(_YAW))
_SIN = torch.from_numpy(np.sin(_YAW))


def yaw_of(rotation: int) -> float:
    """Direction of the actions of a rotation, rad."""
    return float(_YAW[rotation])


def to_picture(
    rotations: torch.Tensor, rows: torch.Tensor, cols: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Pixels of the map -> rows, columns in their pictures (float64). Broadcasts."""
    cos, sin = _COS[rotations], _SIN[rotations]
    down, right = rows - (SIZE - 1) / 2, cols - (SIZE - 1) / 2
    center = (FRAME - 1) / 2
    return cos * down + sin * right + center, cos * right - sin * down + center


def to_map(
    rotations: torch.Tensor, rows: torch.Tensor, cols: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Pixels of pictures -> rows, columns in the map (float64, may lie outside). Broadcasts."""
    cos, sin = _COS[rotations], _SIN[rotations]
    down, right = rows - (FRAME - 1) / 2, cols - (FRAME - 1) / 2
    center = (SIZE - 1) / 2
    return cos * down - sin * right + center, cos * right + sin * down + center


def _nearest(rotations: torch.Tensor, rows: torch.Tensor, cols: torch.Tensor) -> torch.Tensor:
    """Flat index of the map's pixel that each pixel of the pictures shows, or _VOID."""
    exact_row, exact_col = to_map(rotations, rows, cols)
    row, col = exact_row.round().long(), exact_col.round().long()
    inside = (row >= 0) & (row < SIZE) & (col >= 0) & (col < SIZE)
    return torch.where(inside, row * SIZE + col, _VOID)


@lru_cache(maxsize=1)
def _picture_table() -> torch.Tensor:
    """(16, 320, 320) int32: which pixel of the map each picture shows."""
    side = torch.arange(FRAME)
    rotations = torch.arange(ROTATIONS)[:, None, None]
    return _nearest(rotations, side[:, None], side).int()


@lru_cache(maxsize=1)
def _position_table() -> torch.Tensor:
    """(16, 224, 224, 2) float32: where the pixels of the map lie in the pictures, in [-1, 1]."""
    side = torch.arange(SIZE)
    rows, cols = to_picture(torch.arange(ROTATIONS)[:, None, None], side[:, None], side)
    return _normalized(rows, cols, FRAME)


def _normalized(rows: torch.Tensor, cols: torch.Tensor, size: int) -> torch.Tensor:
    return (torch.stack((cols, rows), -1).add(0.5).mul(2 / size).sub(1)).float()


def _gather(state: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """Pixels of one state (C, 224, 224) by index (n, h, w) -> (n, C, h, w), channels last."""
    channels = state.shape[0]
    rows = state.new_zeros((_VOID + 1, channels))
    rows[:-1] = state.permute(1, 2, 0).reshape(_VOID, channels)
    picture = rows.index_select(0, index.reshape(-1))
    return picture.view(*index.shape, channels).permute(0, 3, 1, 2)


def pictures(state: torch.Tensor, rotations: int = ROTATIONS) -> torch.Tensor:
    """One state (C, 224, 224) -> (rotations, C, 320, 320), the first `rotations` turns of it."""
    return _gather(state, _picture_table()[:rotations])


def back_to_map(values: torch.Tensor) -> torch.Tensor:
    """Values on pictures (k, n, h, w), any stride -> (k, n, 224, 224) on the map's pixels."""
    return F.grid_sample(
        values, _position_table()[: len(values)], padding_mode="border", align_corners=False
    )


def positions(rotations: torch.Tensor, rows: torch.Tensor, cols: torch.Tensor) -> torch.Tensor:
    """Pixels of the map (n,) -> (n, 2) their places in whole pictures, in [-1, 1]."""
    return _normalized(*to_picture(rotations, rows, cols), FRAME)


def patches(
    states: torch.Tensor | Sequence[torch.Tensor],
    rotations: torch.Tensor,
    rows: torch.Tensor,
    cols: torch.Tensor,
    *,
    size: int,
    stride: int,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Cut the pictures around actions, without making the pictures.

    states: n of (C, 224, 224); rotations, rows, cols: (n,) int64, one action for each state.
    size: pixels a side; stride: the network's total stride, to whose lattice the cut is
    aligned, so that a network whose receptive field fits sees what it sees in the picture.
    Returns patches (n, C, size, size) and the actions' places in them (n, 2) in [-1, 1].
    """
    index, places = around(rotations, rows, cols, size=size, stride=stride)
    cuts = torch.cat([_gather(state, index[i : i + 1]) for i, state in enumerate(states)])
    return cuts, places


def around(
    rotations: torch.Tensor, rows: torch.Tensor, cols: torch.Tensor, *, size: int, stride: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Which pixel of the map each pixel of such a patch shows, (n, size, size) flat indices, or
    224 * 224 where it shows none; and the places in it (n, 2) in [-1, 1] of what it is cut
    around: rows and cols (n,), which may lie between the map's pixels."""
    exact_row, exact_col = to_picture(rotations, rows, cols)
    top, left = (
        (torch.floor((exact + stride / 2) / stride) * stride - size // 2)
        for exact in (exact_row, exact_col)
    )
    side = torch.arange(size)
    index = _nearest(
        rotations[:, None, None], top[:, None, None] + side[:, None], left[:, None, None] + side
    )
    return index, _normalized(exact_row - top, exact_col - left, size)


def sample(values: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
    """Values (n, c, h, w) at one place (n, 2) each -> (n, c)."""
    grid = places[:, None, None, :].to(values.dtype)
    return F.grid_sample(values, grid, padding_mode="border", align_corners=False)[:, :, 0, 0]
