"""What a network sees of a heightmap: a stack of channels in which unseen is not table."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch

from policies.errors import HeightmapError
from policies.heightmap import SIZE, Heightmap

HEIGHT_SCALE = 20.0  # a 50 mm block is 1
HEIGHT_LIMIT = 0.5  # m; what stands higher, or lies lower, is shown so high or low

_SHADES = np.arange(256, dtype=np.float32) / np.float32(255) - np.float32(0.5)

INSIDE, SEEN, HEIGHT, RED, GREEN, BLUE, GOAL = range(7)


def channels(*, goal: bool) -> int:
    """Number of channels, with or without the goal mask."""
    return 7 if goal else 6


def encode(heightmap: Heightmap, *, goal: bool) -> torch.Tensor:
    """Heightmap -> (6 or 7, 224, 224) float32: inside (1), seen (0 or 1), height, red, green,
    blue (-0.5 to 0.5), and the goal mask. Zero where unseen, and zero outside once turned.

    Raises HeightmapError when a goal is asked for and the heightmap has none.
    """
    if goal and heightmap.goal is None:
        raise HeightmapError("this policy fetches a goal, but Heightmap.goal is None: set it")
    inside = np.ones((SIZE, SIZE), np.bool_)
    shown = heightmap.goal if goal else None
    return torch.from_numpy(stacked(inside, heightmap.height, heightmap.color, shown))


def stacked(
    inside: npt.NDArray[np.bool_],
    height: npt.NDArray[np.float32],
    color: npt.NDArray[np.uint8],
    goal: npt.NDArray[np.bool_] | None,
) -> npt.NDArray[np.float32]:
    """The channels (..., 6 or 7, h, w) of pictures (..., h, w), and (..., h, w, 3) of colour."""
    seen = np.isfinite(height)
    low_to_high = np.where(seen, height, 0).clip(-HEIGHT_LIMIT, HEIGHT_LIMIT)
    state = np.empty(
        (*height.shape[:-2], channels(goal=goal is not None), *height.shape[-2:]), np.float32
    )
    state[..., INSIDE, :, :] = inside
    state[..., SEEN, :, :] = seen
    state[..., HEIGHT, :, :] = low_to_high * np.float32(HEIGHT_SCALE)
    for channel in range(3):
        state[..., RED + channel, :, :] = _SHADES[color[..., channel]] * seen
    if goal is not None:
        state[..., GOAL, :, :] = goal
    return state
