"""What a network sees of a heightmap: a stack of channels in which unseen is not table."""

from __future__ import annotations

import numpy as np
import torch

from policies.errors import HeightmapError
from policies.heightmap import SIZE, Heightmap

HEIGHT_SCALE = 20.0  # a 50 mm block is 1
HEIGHT_LIMIT = 0.5  # m; what stands higher, or lies lower, is shown so high or low

INSIDE, SEEN, HEIGHT, RED, GREEN, BLUE, GOAL = range(7)


def channels(*, goal: bool) -> int:
    """Number of channels, with or without the goal mask."""
    return 7 if goal else 6


def encode(heightmap: Heightmap, *, goal: bool) -> torch.Tensor:
    """Heightmap -> (6 or 7, 224, 224) float32: inside (1), seen (0 or 1), height, red, green,
    blue (-0.5 to 0.5), and the goal mask. Zero where unseen, and zero outside once turned.

    Raises HeightmapError when a goal is asked for and the heightmap has none.
    """
    seen = heightmap.valid
    state = np.zeros((channels(goal=goal), SIZE, SIZE), np.float32)
    state[INSIDE] = 1
    state[SEEN] = seen
    height = np.where(seen, heightmap.height, 0).clip(-HEIGHT_LIMIT, HEIGHT_LIMIT)
    state[HEIGHT] = height * np.float32(HEIGHT_SCALE)
    state[RED : BLUE + 1] = (heightmap.color.transpose(2, 0, 1) / np.float32(255) - 0.5) * seen
    if goal:
        if heightmap.goal is None:
            raise HeightmapError("this policy fetches a goal, but Heightmap.goal is None: set it")
        state[GOAL] = heightmap.goal
    return torch.from_numpy(state)
