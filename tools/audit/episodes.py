"""Why an episode did not complete: the rules of docs/failures.md for whole logs. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, sin

from policies.primitives import Push
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode_log.entries import Step
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.outcome import EndReason, PushOutcome
from tdpg_deploy.workspace import workspace_of
from tools.audit.causes import Cause, Finding
from tools.audit.table_level import TableLevel

NEAR_BORDER = 0.05  # m from the end of a push to the border: an object ahead of it may be beyond

_GRIPPER = "gripper "  # how the drivers' messages name it
_TORN = ("s apart; one of them has ceased", "s old, exposed before", "only one of depth and colour")
_FORCE = ("on its way", "the arm is caught", "something blocks the arm")
_MOVED = ("calibration would be wrong", "table tags have moved")


@dataclass(frozen=True, kw_only=True)
class ActionSummary:
    """What is kept of a step. near_border: m between the end of a push and the border."""

    findings: tuple[Finding, ...]
    near_border: float | None = None

    @property
    def cause(self) -> Cause | None:
        return self.findings[0].cause if self.findings else None


def summarize(step: Step, findings: tuple[Finding, ...], cell: CellConfig) -> ActionSummary:
    return ActionSummary(findings=findings, near_border=_near_border(step, cell))


def explain_episode(
    result: EpisodeResult | None,
    actions: Sequence[ActionSummary],
    cell: CellConfig,
    *,
    level: TableLevel | None = None,
    damage: str | None = None,
) -> tuple[Finding, ...]:
    """Why an episode failed, most specific first; empty for one that went well.

    result: None if the log ends before it was told. level: of the table at the first look.
    damage: what kept the log from being read to its end.
    """
    if result is None:
        evidence = damage or "the log ends before the episode did"
        return (Finding(cause=Cause.TRUNCATED_LOG, evidence=evidence),)
    truth = result.truth or {}
    findings = [
        _drift(level),
        _end(result, actions, cell, truth),
        _lost(actions, truth),
        damage and Finding(cause=Cause.TRUNCATED_LOG, evidence=damage),
    ]
    return tuple(finding for finding in findings if finding)


def _drift(level: TableLevel | None) -> Finding | None:
    if level is None or not level.has_drifted:
        return None
    return Finding(
        cause=Cause.CALIBRATION_DRIFT,
        evidence=f"the table is seen {1000 * level.lift:+.1f} mm from its place, rising by "
        f"{1000 * level.tilt:.1f} mm across the workspace",
    )


def _end(
    result: EpisodeResult,
    actions: Sequence[ActionSummary],
    cell: CellConfig,
    truth: Mapping[str, int],
) -> Finding | None:
    left = truth.get("workspace")
    match result.reason:
        case EndReason.CLEARED if left:
            evidence = f'ended as "cleared" while {left} objects lay in the workspace'
            return Finding(cause=Cause.EMPTY_TABLE_MISJUDGED, evidence=evidence)
        case EndReason.CLEARED | EndReason.GOAL_REACHED:
            return None
        case EndReason.OPERATOR_STOP | EndReason.DEVICE_ERROR | EndReason.FAILED:
            return explain_interruption(result.reason, result.error)
        case EndReason.NOTHING_SEEN:
            evidence = "too little of the table was seen to say what lies there"
            return Finding(cause=Cause.DEPTH_HOLE, evidence=evidence)
        case EndReason.STUCK | EndReason.ACTION_LIMIT | EndReason.NO_ACTION if left == 0:
            evidence = f'ended as "{result.reason.value}" while nothing lay in the workspace'
            return Finding(cause=Cause.EMPTY_TABLE_MISJUDGED, evidence=evidence)
        case EndReason.ACTION_LIMIT:
            evidence = f"{result.actions} actions were not enough: {_most(actions)}"
            return Finding(cause=Cause.TIME_OUT, evidence=evidence)
        case EndReason.STUCK:
            return _most_frequent(actions[-cell.episode.max_failures :], "in a row failed")
        case EndReason.NO_ACTION:
            return actions[-1].findings[0] if actions and actions[-1].findings else _nothing_left()
        case EndReason.GOAL_LOST:
            return _goal_lost(actions)


def explain_interruption(reason: EndReason | None, error: str | None) -> Finding | None:
    """What broke the episode off, perhaps in the midst of an action; None if nothing did."""
    if reason is EndReason.OPERATOR_STOP:
        return Finding(cause=Cause.OPERATOR_STOP, evidence="the operator stopped the episode")
    if reason in (EndReason.DEVICE_ERROR, EndReason.FAILED):
        return _explain_error(error or "no error was logged")
    return None


def _explain_error(error: str) -> Finding:
    """The cause that the error of a device names; `error` is "TypeName: message"."""
    kind, _, message = error.partition(": ")
    cause = Cause.UNKNOWN
    if kind == "ProtectiveStop":
        cause = Cause.PROTECTIVE_STOP
    elif kind == "EmergencyStop":
        cause = Cause.OPERATOR_STOP
    elif kind == "FrameError" or any(text in message for text in _TORN):
        cause = Cause.STALE_FRAME
    elif kind == "CalibrationError" or any(text in message for text in _MOVED):
        cause = Cause.CALIBRATION_DRIFT
    elif kind == "GripperError" or (kind == "DeviceTimeout" and message.startswith(_GRIPPER)):
        cause = Cause.GRIPPER_FAULT
    elif kind == "DeviceTimeout":
        cause = Cause.TIME_OUT
    elif kind == "DeviceUnreachable":
        cause = Cause.CONNECTION_LOST
    elif kind == "CameraError" and "no pixel has depth" in message:
        cause = Cause.DEPTH_HOLE
    elif kind == "PlanRefused":
        cause = Cause.REFUSED_PLAN
    elif any(text in message for text in _FORCE):
        cause = Cause.COLLISION
    return Finding(cause=cause, evidence=error)


def _lost(actions: Sequence[ActionSummary], truth: Mapping[str, int]) -> Finding | None:
    """Objects that ended beside the workspace, and the pushes that may have done it."""
    lost = truth.get("outside", 0)
    pushes = [
        f"action {number} ended {1000 * action.near_border:.0f} mm from the border"
        for number, action in enumerate(actions, start=1)
        if action.near_border is not None and action.near_border < NEAR_BORDER
    ]
    if not lost or not pushes:
        return None
    evidence = f"{lost} objects lie beside the workspace; {', '.join(pushes[-3:])}"
    return Finding(cause=Cause.PUSH_OUT_OF_WORKSPACE, evidence=evidence)


def _goal_lost(actions: Sequence[ActionSummary]) -> Finding:
    border = actions[-1].near_border if actions else None
    if border is not None and border < NEAR_BORDER:
        evidence = f"the goal was not seen after a push that ended {1000 * border:.0f} mm from the "
        return Finding(cause=Cause.PUSH_OUT_OF_WORKSPACE, evidence=f"{evidence}border")
    return Finding(cause=Cause.UNKNOWN, evidence="the goal is seen no more")


def _most_frequent(actions: Sequence[ActionSummary], what: str) -> Finding:
    counts = Counter(action.cause for action in actions if action.cause is not None)
    if not counts:
        return Finding(cause=Cause.UNKNOWN, evidence=f"{len(actions)} actions {what}")
    last = next(a.findings[0] for a in reversed(actions) if a.findings)
    evidence = f"{len(actions)} actions {what}: {_most(actions)}; the last: {last.evidence}"
    return Finding(cause=counts.most_common(1)[0][0], evidence=evidence)


def _most(actions: Sequence[ActionSummary]) -> str:
    counts = Counter(action.cause.value for action in actions if action.cause is not None)
    return ", ".join(f"{count} {cause}" for cause, count in counts.most_common(3)) or "none failed"


def _nothing_left() -> Finding:
    return Finding(cause=Cause.UNKNOWN, evidence="the policy had no action left to offer")


def _near_border(step: Step, cell: CellConfig) -> float | None:
    """m from where a push ended to the border of the workspace; None for all else."""
    if step.intent is None or not isinstance(step.outcome, PushOutcome):
        return None
    push = step.intent.decision.primitive
    if not isinstance(push, Push):
        return None
    x = push.x + step.outcome.travelled * cos(push.yaw)
    y = push.y + step.outcome.travelled * sin(push.yaw)
    square = workspace_of(cell)
    inside = min(x - square.x_min, square.x_max - x, y - square.y_min, square.y_max - y)
    return max(float(inside), 0.0)
