"""What of a 2F-85 decides where it can grasp and push."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# 2F-85 manual, section 6.1
OPEN_WIDTH = 0.085  # m between the pads
PAD_WIDTH = 0.022  # m


@dataclass(frozen=True, kw_only=True)
class Part:
    """Of the gripper that points down, as seen from above: a rectangle (m) along and across the
    yaw of the action, or two whose centres lie `apart` from each other along it.

    rise: metres from the closed finger tips, the lowest place of them all, up to its lower end.
    """

    along: float
    across: float
    apart: float = 0.0
    rise: float = 0.0


# What comes down around a grasp: the finger tips behind their pads (2F-85 manual, section 6.1),
# the bars that carry them, and the palm; open tips swing up by 14 mm, and their bars with them.
# 2 mm to spare all around, but not towards what is grasped: corners are seen to a pixel, no better.
OPEN_GRIPPER = (
    Part(along=0.020, across=0.026, apart=OPEN_WIDTH + 0.020),
    Part(along=0.028, across=0.030, apart=OPEN_WIDTH + 0.036, rise=0.050),
    Part(along=0.104, across=0.066, rise=0.067),
)
# What comes down for a push, which moves across the fingers, with 5 mm to spare all around: the
# closed tips side by side, their bars, and the palm. There is no need to begin close to a thing.
CLOSED_GRIPPER = (
    Part(along=0.032, across=0.038),
    Part(along=0.036, across=0.070, rise=0.036),
    Part(along=0.072, across=0.110, rise=0.067),
)
MAX_UNKNOWN = 0.2  # share of a footprint: lost pixels and the rim of a shadow, no more
GRASP_DEPTH = 0.04  # m that the fingers reach below a surface at most (VPG, robot.py)
MIN_GRASP_DEPTH = 0.02  # m that they reach at least, about half of their pads ...
FLAT = 0.01  # m ... or less, where they come down no higher than this above the table


def have_room(surface: npt.ArrayLike, ground: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Whether fingers reach deep enough below a surface that they are to grasp before they come
    down on the ground beside it. Metres above the table; broadcast."""
    deep_enough = np.asarray(surface) - np.float32(MIN_GRASP_DEPTH)
    return np.asarray(ground) <= np.maximum(deep_enough, np.float32(FLAT))
