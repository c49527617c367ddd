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


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A cause, and the numbers that it rests on."""

    cause: Cause
    evidence: str
