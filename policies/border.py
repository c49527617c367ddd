"""What stands right around a goal, as EPG and GI look at it."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F

from policies.heightmap import Heightmap
from policies.standing import rising

BORDER = 5  # pixels; width of the border around the goal


def border_occupancy(heightmap: Heightmap) -> float:
    """Part of the goal's border that rises above the table; 0 without a goal."""
    occupied, border, _ = _pixels(heightmap)
    return occupied / border if border else 0.0


def border_norm(heightmap: Heightmap) -> float:
    """As many times the goal's own area rises in its border; 0 without a goal."""
    occupied, _, goal = _pixels(heightmap)
    return occupied / goal if goal else 0.0


def _pixels(heightmap: Heightmap) -> tuple[int, int, int]:
    """Of what rises in the border, of the border, of the goal."""
    if heightmap.goal is None:
        return 0, 0, 0
    goal = torch.from_numpy(heightmap.goal.astype(np.float32))[None, None]
    grown = F.max_pool2d(goal, 2 * BORDER + 1, stride=1, padding=BORDER)[0, 0].numpy() > 0
    border = grown & ~heightmap.goal
    return int((rising(heightmap) & border).sum()), int(border.sum()), int(heightmap.goal.sum())
