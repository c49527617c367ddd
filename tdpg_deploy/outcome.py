"""What happened: measured by `execution` and `episode`, never assumed. Unknown is a value."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

# Between the pads: the gripper's reading is good to a count or two of 0.4 mm; the thinnest block
# is 25 mm.
EMPTY_BELOW = 0.003  # m
HELD_ABOVE = 0.006  # m


class Verdict(Enum):
    YES = "yes"
    NO = "no"
    UNKNOWN = "unknown"


@dataclass(frozen=True, kw_only=True)
class Motion:
    """How the plan ran. contact: name of the step that force ended early, else None.

    seconds: of the cell's clock, first step to last.
    """

    contact: str | None
    seconds: float


@dataclass(frozen=True, kw_only=True)
class GraspOutcome:
    """Two witnesses of a grasp.

    width_after_close, width_after_lift, width_at_release: metres between the pads; nan when
    not measured.
    held_by_width: whether something kept the pads apart after the lift.
    gone_from_map: whether the heightmap around the grasp fell, or the goal that was grasped is
        not to be seen, in the next frame.
    """

    motion: Motion
    width_after_close: float
    width_after_lift: float
    held_by_width: Verdict
    gone_from_map: Verdict
    width_at_release: float = math.nan

    @property
    def success(self) -> Verdict:
        """What the witnesses agree on; one that saw nothing has no vote."""
        witnesses = {self.held_by_width, self.gone_from_map} - {Verdict.UNKNOWN}
        return witnesses.pop() if len(witnesses) == 1 else Verdict.UNKNOWN


@dataclass(frozen=True, kw_only=True)
class PushOutcome:
    """changed: whether the heightmap changed along the push, seen by the next frame.

    travelled: metres between the start and the end of the push, as measured by the arm.
    """

    motion: Motion
    travelled: float
    changed: Verdict

    @property
    def success(self) -> Verdict:
        return self.changed


Outcome = GraspOutcome | PushOutcome


class EndReason(Enum):
    """Why an episode ended."""

    CLEARED = "cleared"  # nothing is left that rises above the table
    GOAL_REACHED = "goal reached"
    STUCK = "stuck"  # ten actions in a row without success (paper, section IV)
    NO_ACTION = "no action"  # every action was refused or unknown
    ACTION_LIMIT = "action limit"
    GOAL_LOST = "goal lost"
    NOTHING_SEEN = "nothing seen"  # the depth image is unknown: not the same as an empty table
    DEVICE_ERROR = "device error"
    OPERATOR_STOP = "operator stop"
    FAILED = "failed"  # not the devices: this program, its log or its disk
