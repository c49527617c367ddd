"""What is going to happen: a plan, made by `motion`, judged by `safety`, run by `execution`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from tdpg_deploy.geometry import Array, Transform

if TYPE_CHECKING:  # whoever only checks motions, such as calibration, loads no policies
    from policies.primitives import Primitive


@dataclass(frozen=True, kw_only=True, eq=False)
class MoveJoints:
    """Straight in joint space. q: (6,) rad; speed rad/s; acceleration rad/s^2."""

    name: str
    q: Array
    speed: float
    acceleration: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MoveLinear:
    """Straight in space. Speed m/s; acceleration m/s^2.

    stop_force: newtons at which the motion ends in contact; None only in free space.
    """

    name: str
    X_base_tool: Transform
    speed: float
    acceleration: float
    stop_force: float | None = None


@dataclass(frozen=True, kw_only=True)
class MoveFingers:
    """Drive the pads to `width` (m) at `speed` (m/s), blocked at `force` (N)."""

    name: str
    width: float
    speed: float
    force: float


Step: TypeAlias = MoveJoints | MoveLinear | MoveFingers


@dataclass(frozen=True, kw_only=True)
class Plan:
    """One primitive as steps.

    approach:  up to and including contact: open, above, descend, close (or push), lift.
    delivery:  run after a grasp that holds something: to the bin, open.
    retreat:   always run at the end: back home, out of the camera's sight.
    notes:     what differs from what was asked, e.g. "push shortened from 0.100 to 0.062 m".
    """

    primitive: Primitive
    approach: tuple[Step, ...]
    delivery: tuple[Step, ...] = ()
    retreat: tuple[Step, ...] = ()
    notes: tuple[str, ...] = ()
