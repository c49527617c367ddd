"""What a step of a log says of its action: the rules of docs/failures.md, first match first. Pure.

They read documents alone; where a step brings its arm states too, the evidence says more.
"""

from __future__ import annotations

from math import isfinite, pi

import numpy as np

from policies.primitives import Grasp, Primitive
from tdpg_deploy.episode_log.entries import Intent, Refusal, Step
from tdpg_deploy.outcome import (
    EMPTY_BELOW,
    HELD_ABOVE,
    GraspOutcome,
    Outcome,
    PushOutcome,
    Verdict,
)
from tdpg_deploy.plan import MoveLinear
from tools.audit.causes import Cause, Finding

SAME_PLACE = 0.01  # m
SAME_TURN = pi / 16  # rad: less lies between two of the sixteen rotations
CLOCK_ERROR = 0.02  # s: a camera on USB dates its frames no better

# What motion.py and safety.py say of the plans that they refuse, by cause.
_REFUSALS = {
    Cause.DEPTH_HOLE: ("is unknown; at most", "no surface was seen there"),
    Cause.PUSH_OUT_OF_WORKSPACE: ("of room in the workspace",),
    Cause.UNREACHABLE: (
        "is out of reach",
        "leaves the arm's reach",
        "passes a singularity",
        "outside limits.joint_range",
    ),
}
# The steps of motion.py's descent: the first ends well above all that the plan knows of.
_DESCENT = {"lower": ", above what was seen there", "descend": ""}


def refusal_cause(reason: str) -> Cause:
    for cause, phrases in _REFUSALS.items():
        if any(phrase in reason for phrase in phrases):
            return cause
    return Cause.REFUSED_PLAN


def explain_action(
    step: Step, previous: Step | None = None, interruption: Finding | None = None
) -> tuple[Finding, ...]:
    """Why the action of `step` failed, most specific first; empty for one that succeeded.

    previous: the step before, to see repetitions. interruption: what ended the episode, where that
    may happen in the midst of an action.
    """
    if step.intent is None:
        return _explain_refusals(step.refusals)
    if step.outcome is None:
        cut = Finding(cause=Cause.TRUNCATED_LOG, evidence="the log tells no outcome")
        return (interruption or cut,)
    if step.outcome.success is Verdict.YES:
        return ()
    findings = [
        _stale_frame(step, step.intent, step.outcome),
        _repeated(step.intent, previous),
        _stopped_by_force(step, step.intent, step.outcome),
        _grasp(step.outcome) if isinstance(step.outcome, GraspOutcome) else _push(step.outcome),
    ]
    found = tuple(finding for finding in findings if finding is not None)
    return found or (_unknown(step.outcome),)


def _explain_refusals(refusals: tuple[Refusal, ...]) -> tuple[Finding, ...]:
    """One finding for each cause, the most frequent first."""
    reasons: dict[Cause, list[str]] = {}
    for refusal in refusals:
        reasons.setdefault(refusal_cause(refusal.reason), []).append(refusal.reason)
    return tuple(
        Finding(cause=cause, evidence=f"{len(found)} of {len(refusals)} refused: {found[-1]}")
        for cause, found in sorted(reasons.items(), key=lambda item: -len(item[1]))
    )


def _stale_frame(step: Step, intent: Intent, outcome: Outcome) -> Finding | None:
    """The look that judged the action was not taken after it."""
    before, after = step.seen, step.next_seen
    if after is None:
        return None
    if before is not None and after.sequence <= before.sequence:
        evidence = f"frame {after.sequence} came after frame {before.sequence}"
        return Finding(cause=Cause.STALE_FRAME, evidence=evidence)
    early = intent.stamp + outcome.motion.seconds - after.captured_at
    if early <= CLOCK_ERROR:
        return None
    evidence = f"frame {after.sequence} was captured {early:.3f} s before the action was over"
    return Finding(cause=Cause.STALE_FRAME, evidence=evidence)


def _repeated(intent: Intent, previous: Step | None) -> Finding | None:
    """The same as the action before, which had failed too."""
    if previous is None or previous.intent is None or previous.outcome is None:
        return None
    one, other = previous.intent.decision.primitive, intent.decision.primitive
    if previous.outcome.success is Verdict.YES or type(one) is not type(other):
        return None
    distance = float(np.hypot(one.x - other.x, one.y - other.y))
    turn = turn_between(one, other)
    if distance > SAME_PLACE or turn > SAME_TURN:
        return None
    return Finding(
        cause=Cause.REPEATED_ACTION,
        evidence=f"{1000 * distance:.0f} mm and {np.degrees(turn):.0f} deg from the action before, "
        f"whose success was {previous.outcome.success.value}",
    )


def turn_between(one: Primitive, other: Primitive) -> float:
    """rad between two directions, in [0, pi]; a grasp turned by pi is the same grasp."""
    period = pi if isinstance(one, Grasp) else 2 * pi
    turn = abs(one.yaw - other.yaw) % period
    return min(turn, period - turn)


def _stopped_by_force(step: Step, intent: Intent, outcome: Outcome) -> Finding | None:
    contact = outcome.motion.contact
    if contact is None:
        return None
    motions = [each for each in intent.plan.approach if isinstance(each, MoveLinear)]
    ended = next((motion for motion in motions if motion.name == contact), None)
    limit = "" if ended is None else f"more than {ended.stop_force} N"
    evidence = f'{limit or "force"} ended "{contact}"'
    if contact in _DESCENT:
        evidence += _DESCENT[contact] + _how_far(step, ended)
        return Finding(cause=Cause.FINGER_ON_OBJECT, evidence=evidence)
    return Finding(cause=Cause.COLLISION, evidence=evidence)


def _how_far(step: Step, descent: MoveLinear | None) -> str:
    """How high above its goal the descent ended; nothing if the states were not read."""
    if descent is None or not step.tool_path:
        return ""
    lowest = min(point.p_base[2] for point in step.tool_path)
    above = lowest - float(descent.X_base_tool.translation[2])
    return f", {1000 * above:.0f} mm above its goal"


def _grasp(outcome: GraspOutcome) -> Finding | None:
    close, lift = _mm(outcome.width_after_close), _mm(outcome.width_after_lift)
    release = _mm(outcome.width_at_release)
    was_closed_on = outcome.width_after_close > HELD_ABOVE
    if was_closed_on and outcome.width_after_lift < EMPTY_BELOW:
        evidence = f"the pads stood {close} apart when closed and {lift} after the lift"
        return Finding(cause=Cause.SLIP, evidence=evidence)
    if outcome.held_by_width is Verdict.YES and outcome.width_at_release < EMPTY_BELOW:
        evidence = f"the pads stood {lift} apart after the lift and {release} over the bin"
        return Finding(cause=Cause.SLIP, evidence=evidence)
    if outcome.held_by_width is Verdict.NO and outcome.width_after_lift < HELD_ABOVE:
        evidence = f"the pads met on nothing: {close} apart when closed, {lift} after the lift"
        if outcome.gone_from_map is not Verdict.YES:
            return Finding(cause=Cause.MISSED_GRASP, evidence=evidence)
        if outcome.width_after_close < EMPTY_BELOW:  # it cannot have been lifted
            evidence += "; what stood there was pushed aside"
            return Finding(cause=Cause.MISSED_GRASP, evidence=evidence)
    if outcome.held_by_width is Verdict.UNKNOWN and outcome.gone_from_map is Verdict.NO:
        evidence = f"nothing left the map; the pads, {lift} apart after the lift, say nothing"
        return Finding(cause=Cause.MISSED_GRASP, evidence=evidence)
    return None


def _push(outcome: PushOutcome) -> Finding | None:
    if outcome.changed is not Verdict.NO:
        return None
    evidence = f"nothing changed on the map; the tool travelled {_mm(outcome.travelled)}"
    return Finding(cause=Cause.PUSH_WITHOUT_EFFECT, evidence=evidence)


def _unknown(outcome: Outcome) -> Finding:
    if isinstance(outcome, GraspOutcome):
        evidence = (
            f"held: {outcome.held_by_width.value} ({_mm(outcome.width_after_lift)} after the "
            f"lift), gone from the map: {outcome.gone_from_map.value}"
        )
    else:
        evidence = f"changed: {outcome.changed.value}, travelled {_mm(outcome.travelled)}"
    return Finding(cause=Cause.UNKNOWN, evidence=evidence)


def _mm(width: float) -> str:
    return f"{abs(1000 * width):.1f} mm" if isfinite(width) else "an unmeasured width"
