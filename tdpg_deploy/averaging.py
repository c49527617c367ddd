"""Several depth images of a still scene -> one, steadier and without lies at its edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tdpg_deploy.compiled import compiled

SAME_SURFACE = 0.02  # of the depth; where an edge trembles, frames differ by more

Depth = npt.NDArray[np.float32]


def mean_depth(depths: Sequence[Depth]) -> Depth:
    """(H, W) each, metres, nan where unknown. The mean of what lies close to the median of what
    was seen; nan where not more than half of the frames agree."""
    return depths[0] if len(depths) == 1 else _mean_near_median(np.stack(depths))


@compiled
def _mean_near_median(stack: npt.NDArray[np.float32]) -> Depth:
    frames, rows, cols = stack.shape
    mean = np.full((rows, cols), np.nan, np.float32)
    values = np.empty(frames, np.float32)
    for row in range(rows):
        for col in range(cols):
            seen = 0
            for frame in range(frames):
                value = stack[frame, row, col]
                if np.isnan(value):
                    continue
                place = seen
                while place > 0 and values[place - 1] > value:
                    values[place] = values[place - 1]
                    place -= 1
                values[place] = value
                seen += 1
            if 2 * seen <= frames:
                continue
            median = values[seen // 2]
            total, agreed = 0.0, 0
            for value in values[:seen]:
                if abs(value - median) < SAME_SURFACE * median:
                    total += value
                    agreed += 1
            if 2 * agreed > frames:
                mean[row, col] = total / agreed
    return mean
