"""What of a 2F-85 decides where it can grasp and push."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

OPEN_WIDTH = 0.085  # m between the pads, 2F-85 manual, section 6.1
PAD_WIDTH = 0.022  # m, 2F-85 manual, section 6.1
FINGER_DEPTH = 0.018  # m from a pad's face to the finger's back
# m along and across a push: both closed fingers where they are broadest, 2 mm to spare all around
CLOSED_FINGERS = 0.030, 0.064
MAX_UNKNOWN = 0.2  # share of a footprint: lost pixels and the rim of a shadow, no more
MIN_GRASP_DEPTH = 0.02  # m that the fingers reach below a surface, about half of their pads ...
FLAT = 0.01  # m ... or less, where they come down no higher than this above the table


def have_room(surface: npt.ArrayLike, ground: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Whether fingers reach deep enough below a surface that they are to grasp before they come
    down on the ground beside it. Metres above the table; broadcast."""
    deep_enough = np.asarray(surface) - np.float32(MIN_GRASP_DEPTH)
    return np.asarray(ground) <= np.maximum(deep_enough, np.float32(FLAT))
