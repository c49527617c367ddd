"""Why an action or an episode failed. docs/failures.md states the rule behind each cause."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Cause(Enum):
    MISSED_GRASP = "missed grasp"
    SLIP = "slip after lift"
    COLLISION = "collision or force stop"
    FINGER_ON_OBJECT = "finger on object"
    PUSH_WITHOUT_EFFECT = "push without effect"
    PUSH_OUT_OF_WORKSPACE = "push out of the workspace"
    REPEATED_ACTION = "repeated action"
    REFUSED_PLAN = "refused plan"
    UNREACHABLE = "unreachable"
    DEPTH_HOLE = "depth hole under target"
    STALE_FRAME = "stale or torn frame"
    CALIBRATION_DRIFT = "calibration drift"
    GRIPPER_FAULT = "gripper fault"
    PROTECTIVE_STOP = "protective stop"
    OPERATOR_STOP = "operator stop"
    EMPTY_TABLE_MISJUDGED = "empty table misjudged"
    TIME_OUT = "time-out"
    CONNECTION_LOST = "connection lost"
    TRUNCATED_LOG = "truncated log"
    UNKNOWN = "unknown"


WHAT_TO_CHANGE = {
    Cause.MISSED_GRASP: "all to the same side: calibrate anew (tdpg-calibrate touch tells); on "
    "some objects only: try another checkpoint (tdpg-replay --policy), train on such objects",
    Cause.SLIP: "raise gripper.force, clean or renew the pads; at corners or off the centre only: "
    "another checkpoint",
    Cause.COLLISION: "free what stands in the way; if the load was wanted, raise limits.push_force",
    Cause.FINGER_ON_OBJECT: "everywhere: check depth and height (tdpg-doctor, workspace.table_z); "
    "close to neighbours only: another checkpoint, or push first",
    Cause.PUSH_WITHOUT_EFFECT: "all of them: check the height (tdpg-doctor, workspace.table_z); "
    "some: another checkpoint",
    Cause.PUSH_OUT_OF_WORKSPACE: "put objects further from the border, or move workspace.center",
    Cause.REPEATED_ACTION: "mend why the first one failed; where it keeps on, lower "
    "episode.max_failures or try another checkpoint",
    Cause.REFUSED_PLAN: "the refusal names the rule: widen that limit of the cell file if the "
    "cell allows it",
    Cause.UNREACHABLE: "move workspace.center or bin.position nearer to the arm, or widen "
    "limits.joint_range",
    Cause.DEPTH_HOLE: "let the camera see more: camera.frames_averaged, camera.preset, more light, "
    "a steeper view; dark and shiny objects stay hard",
    Cause.STALE_FRAME: "give the camera a USB 3 port of its own, lower camera.fps or camera.width, "
    "take load off the computer",
    Cause.CALIBRATION_DRIFT: "camera or table has moved: calibrate anew, measure workspace.table_z",
    Cause.GRIPPER_FAULT: "the error says what to do; examine with tdpg-doctor --device gripper",
    Cause.PROTECTIVE_STOP: "look what the arm met; then arm.payload, limits.joint_acceleration "
    "and the speed limits",
    Cause.OPERATOR_STOP: "ask who stopped it: the log does not know why",
    Cause.EMPTY_TABLE_MISJUDGED: "too flat to be seen, or noise taken for an object: "
    "workspace.table_z and the camera's noise (tdpg-doctor)",
    Cause.TIME_OUT: "too many actions: mend their most frequent cause, or raise "
    "episode.max_actions; a device: its row in docs/faults.md",
    Cause.CONNECTION_LOST: "check power, cable and address (tdpg-doctor; docs/faults.md)",
    Cause.TRUNCATED_LOG: "the process was killed, lost power or filled the disk: the computer's "
    "own log tells; tdpg-log recover saves the rest",
    Cause.UNKNOWN: "look at the step's page: no rule fits",
}


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A cause, and the numbers that it rests on."""

    cause: Cause
    evidence: str
