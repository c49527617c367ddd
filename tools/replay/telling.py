"""A step in words: what was seen, decided, measured. Pure; for terminals, captions and viewers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite

import numpy as np

from policies.heightmap import Heightmap
from policies.primitives import Primitive, Push
from tdpg_deploy.episode_log.entries import LoggedDecision, Step
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.outcome import GraspOutcome, Outcome, Verdict
from tools.audit.actions import explain_action
from tools.audit.causes import WHAT_TO_CHANGE, Finding
from tools.audit.episodes import explain_interruption
from tools.replay.divergence import Divergence
from tools.replay.redecide import Proposal, Redecision
from tools.replay.reenact import ALIKE, TableFrom, Tried

RISE = 0.01  # m; what stands higher is an object
WORDS = {Verdict.YES: "success", Verdict.NO: "failed", Verdict.UNKNOWN: "unclear"}

Line = tuple[str, str]  # a label, and what it says


def tell_each(episode: Episode) -> Iterator[tuple[Step, list[Line]]]:
    """Each step with its lines, last of them why it failed and what to change. Raises LogError
    at damage, after all that lies before it."""
    result, previous = episode.result(), None
    ended = None if result is None else explain_interruption(result.reason, result.error)
    for step in episode.steps():
        yield step, [*tell(step), *why(explain_action(step, previous, ended))]
        previous = step


def why(findings: Sequence[Finding]) -> Iterator[Line]:
    for finding in findings:
        yield "why", f"{finding.cause.value}: {finding.evidence}"
    if findings:
        yield "change", WHAT_TO_CHANGE[findings[0].cause]


def tell(step: Step) -> Iterator[Line]:
    """The lines of one step, in the order in which things happened."""
    yield "seen", "the look is lost" if step.look is None else seen(step.look.heightmap)
    for refusal in step.refusals:
        yield "refused", f"{action(refusal.decision.primitive)}: {refusal.reason}"
    if step.intent is None:
        yield "decided", "nothing: no action is left"
        return
    yield "decided", decision(step.intent.decision)
    for note in step.intent.plan.notes:
        yield "planned", note
    if step.tool_path:
        yield "moved", motion(step)
    if step.outcome is None:
        yield "outcome", "not known: the log ends before"
    else:
        yield "measured", measured(step.outcome)
        yield "outcome", WORDS[step.outcome.success]


def seen(heightmap: Heightmap) -> str:
    known = heightmap.valid
    high = np.nan_to_num(heightmap.height) > RISE
    highest = 1000 * float(np.nanmax(heightmap.height)) if known.any() else float("nan")
    text = f"{known.mean():.1%} known, {high.mean():.1%} occupied, highest point {highest:.0f} mm"
    if heightmap.goal is None:
        return text
    return f"{text}, goal {int(heightmap.goal.sum())} pixels"


def action(primitive: Primitive) -> str:
    p = primitive
    text = f"at ({p.x:.3f}, {p.y:+.3f}, {p.z:+.3f}) m, yaw {np.degrees(p.yaw):.1f} deg"
    return f"push {text}, {1000 * p.length:.0f} mm" if isinstance(p, Push) else f"grasp {text}"


def decision(made: LoggedDecision) -> str:
    text = f"{action(made.primitive)}, q {made.q:.3f}"
    others = made.grasps if isinstance(made.primitive, Push) else made.pushes
    if others:
        kind = "grasp" if isinstance(made.primitive, Push) else "push"
        text += f" (best {kind} {max(other.q for other in others):.3f})"
    if made.verdict is not None:
        said = "overruled" if made.verdict.overruled else "agreed"
        text += f", Critic II {said}, best P(success) {max(made.verdict.p_success):.2f}"
    if made.p_foreseen is not None:
        text += f", foreseen to work: {made.p_foreseen:.0%}"
    return f"{text}, {1000 * sum(made.seconds.values()):.0f} ms"


def motion(step: Step) -> str:
    path = step.tool_path
    force = max(point.force for point in path)
    lowest = min(point.p_base[2] for point in path)
    seconds = path[-1].stamp - path[0].stamp
    return f"{seconds:.1f} s, lowest at z = {lowest:+.3f} m, peak force {force:.1f} N"


def measured(outcome: Outcome) -> str:
    if isinstance(outcome, GraspOutcome):
        widths = (outcome.width_after_close, outcome.width_after_lift, outcome.width_at_release)
        shown = ", ".join(f"{abs(1000 * w):.0f}" if isfinite(w) else "-" for w in widths)
        text = (
            f"widths after close, lift, at release {shown} mm; held by width "
            f"{outcome.held_by_width.value}, gone from map {outcome.gone_from_map.value}"
        )
    else:
        text = f"travelled {1000 * outcome.travelled:.0f} mm, map changed {outcome.changed.value}"
    contact = outcome.motion.contact
    return text if contact is None else f"{text}; touched something: {contact}"


def result(ended: EpisodeResult | None) -> str:
    if ended is None:
        return "the log ends before the episode did"
    return (
        f"{ended.reason.value}: {ended.grasp_successes} of {ended.grasps} grasps, "
        f"{ended.push_successes} of {ended.pushes} pushes, {ended.refused} refused, "
        f"{ended.seconds:.0f} s of the robot's time"
    )


# --- decided again ----------------------------------------------------------------------------


def tell_again(step: Redecision, divergence: Divergence | None) -> Iterator[Line]:
    """How the step went when it was decided again."""
    if step.seen is None:
        yield "again", "the look is lost: nothing to decide on"
    elif divergence is None:
        yield "again", "the same, bit for bit"
    else:
        yield "again", proposed(step.again)
        yield "differs", f"{divergence.stage.value}: {divergence.found}"
        evidence = "; ".join(divergence.evidence) or "nothing that was logged is another"
        yield "cause", f"{divergence.cause.value} ({evidence})"


def proposed(proposals: tuple[Proposal, ...]) -> str:
    if not proposals:
        return "no action"
    *_, last = proposals
    refused = sum(proposal.refusal is not None for proposal in proposals)
    text = decision(last.decision) if last.refusal is None else f"no action: {last.refusal}"
    return f"{text}, {refused} refused before" if refused and last.refusal is None else text


# --- tried again ------------------------------------------------------------------------------


def tell_tried(tried: Tried, *, logged_by: str | None, commit: str | None) -> Iterator[Line]:
    """How an action went in the simulated cell. logged_by, commit: of the code that wrote the log,
    and of this one."""
    yield "estimate", f"step {tried.number} in the simulated cell, on {tried.table.value}"
    yield (
        "table",
        f"{tried.objects} objects; {tried.likeness:.1%} of the heights known in both agree "
        f"within {1000 * ALIKE:.0f} mm with what was logged",
    )
    yield "tried", action(tried.primitive)
    logged = tried.logged
    yield "logged", "no outcome" if logged is None else _outcome(logged)
    yield (
        "here",
        tried.error or ("no outcome" if tried.outcome is None else _outcome(tried.outcome)),
    )
    if tried.same:
        yield "", "the same, bit for bit"
    elif tried.table is TableFrom.SCENE and commit != logged_by:
        by = f"commit {commit or 'unknown'}, in the log {logged_by or 'unknown'}"
        yield "differs", f"perhaps because the code does, and its physics with it ({by})"


def _outcome(outcome: Outcome | None) -> str:
    if outcome is None:
        return "not known"
    return f"{WORDS[outcome.success]}: {measured(outcome)}, {outcome.motion.seconds:.1f} s"
