"""The two things the arm can do. Frozen, in the base frame, metres and radians.

`yaw` turns about base z, counter-clockwise seen from above; 0 points along base +x.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

PUSH_LENGTH = 0.13  # m; VPG and the paper push 0.10: what they open less often (docs/results.md)


@dataclass(frozen=True, kw_only=True)
class Grasp:
    """Close the fingers from above on the point (x, y, z).

    The fingers stand at both sides of the point on the line of direction `yaw`, so
    yaw and yaw + pi name the same grasp. z is the height of the surface seen there.
    """

    x: float
    y: float
    z: float
    yaw: float


@dataclass(frozen=True, kw_only=True)
class Push:
    """Travel `length` metres from (x, y, z) towards `yaw` with closed fingers.

    z is the height of the surface seen at the start.
    """

    x: float
    y: float
    z: float
    yaw: float
    length: float = PUSH_LENGTH


Primitive: TypeAlias = Grasp | Push
