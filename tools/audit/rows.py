"""One log -> its row and the rows of its actions. Reads documents and one heightmap, no picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.Grid_pb2 import Grid

from policies.heightmap import Heightmap
from tdpg_deploy.episode_log import channels, messages
from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.entries import End, Entry, Step
from tdpg_deploy.episode_log.grouping import group
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import LogError
from tdpg_deploy.outcome import EndReason, GraspOutcome, PushOutcome
from tools.audit.actions import explain_action, refusal_cause
from tools.audit.causes import Finding
from tools.audit.episodes import (
    ActionSummary,
    explain_episode,
    explain_interruption,
    summarize,
)
from tools.audit.table_level import TableLevel, table_level
from tools.evaluate.metrics import EpisodeRow
from tools.evaluate.rows import objects_of

NAN = math.nan


@dataclass(frozen=True, kw_only=True)
class EpisodeRecord:
    """A row of the table of episodes.

    reason: None, and counts by what was read, if the log is truncated. cause, evidence: of the
    first finding; causes: of all. table_lift, table_tilt: metres, nan where not seen. objects: at
    the start. left, lost: in the workspace and beside it at the end, as the simulator counts them.
    """

    episode: str
    path: str
    started_at: datetime
    cell: str
    policy: str
    checkpoint: str | None
    commit: str | None
    seed: int | None
    reason: str | None
    completed: bool
    cause: str | None
    evidence: str | None
    causes: tuple[str, ...]
    objects: int
    actions: int
    grasps: int
    grasp_successes: int
    pushes: int
    push_successes: int
    delivered: int
    refused: int
    seconds: float
    table_lift: float
    table_tilt: float
    left: int | None
    lost: int | None
    error: str | None


@dataclass(frozen=True, kw_only=True)
class ActionRecord:
    """A row of the table of actions; kind "none" is a look to which every plan was refused.

    x, y, z, yaw: the action's, in base (m, rad). widths: metres between the pads. contact: the
    step that force ended. p_success: Critic II's best. decide_seconds: of all parts together.
    refusals: causes of the plans that were refused before.
    """

    episode: str
    step: int
    kind: str
    success: str | None
    cause: str | None
    evidence: str | None
    causes: tuple[str, ...]
    q: float
    rotation: int | None
    x: float
    y: float
    z: float
    yaw: float
    contact: str | None
    seconds: float
    width_after_close: float
    width_after_lift: float
    width_at_release: float
    travelled: float
    p_success: float
    overruled: bool | None
    p_foreseen: float
    decide_seconds: float
    refusals: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class AuditedLog:
    """All that the audit keeps of a log. findings: of the episode. row: for the metrics; None if
    it was truncated."""

    episode: EpisodeRecord
    findings: tuple[Finding, ...]
    actions: tuple[ActionRecord, ...]
    row: EpisodeRow | None


def audit_log(path: Path, *, name: str) -> AuditedLog:
    """Raises LogError for a file that is not an episode's log."""
    episode = read_episode(path)
    results: list[EpisodeResult] = []
    records: list[ActionRecord] = []
    summaries: list[ActionSummary] = []
    damage, previous = None, None
    try:
        for step in group(_noting_results(episode, results)):
            ended = explain_interruption(results[-1].reason, results[-1].error) if results else None
            findings = explain_action(step, previous, ended)
            records.append(_action(name, len(records) + 1, step, findings))
            summaries.append(summarize(step, findings, episode.about.cell))
            previous = step
    except LogError as error:
        damage = str(error)
    result = results[-1] if results else None
    seen = first_heightmap(episode)
    level = None if seen is None else table_level(seen)
    goal = seen is not None and seen.goal is not None
    findings = explain_episode(result, summaries, episode.about.cell, level=level, damage=damage)
    counts = result or _counted(records)
    objects = objects_of(episode.about, counts)
    row = None if result is None else metrics_row(episode.about, result, objects, goal)
    return AuditedLog(
        episode=_episode(episode, name, counts, row, objects, findings, level),
        findings=findings,
        actions=tuple(records),
        row=row,
    )


def metrics_row(about: About, result: EpisodeResult, objects: int, goal: bool) -> EpisodeRow:
    """objects: at the start. goal: whether one of them was to be fetched."""
    return EpisodeRow(
        scene=f"{objects} objects",
        seed=about.seed or 0,
        reason=result.reason,
        goal=goal,
        objects=1 if goal else objects,
        actions=result.actions,
        grasps=result.grasps,
        grasp_successes=result.grasp_successes,
    )


def first_heightmap(episode: Episode) -> Heightmap | None:
    """Of the first look; None if there is none or it cannot be read."""
    try:
        for _, grid in episode.raw({channels.HEIGHTMAP}):
            return messages.decode_heightmap(messages.parse(Grid, grid), None)
    except LogError:
        return None
    return None


def _noting_results(episode: Episode, results: list[EpisodeResult]) -> Iterator[Entry]:
    for entry in episode.entries(images=False, states=False):
        if isinstance(entry, End):
            results.append(entry.result)
        yield entry


def _episode(
    episode: Episode,
    name: str,
    counts: EpisodeResult,
    row: EpisodeRow | None,
    objects: int,
    findings: tuple[Finding, ...],
    level: TableLevel | None,
) -> EpisodeRecord:
    about, truth = episode.about, counts.truth or {}
    return EpisodeRecord(
        episode=name,
        path=str(episode.path),
        started_at=datetime.fromtimestamp(about.started_at, timezone.utc),
        cell=about.cell.name,
        policy=about.policy,
        checkpoint=about.checkpoint_sha256,
        commit=about.commit,
        seed=about.seed,
        reason=None if row is None else row.reason.value,
        completed=row is not None and row.completed,
        objects=objects,
        actions=counts.actions,
        grasps=counts.grasps,
        grasp_successes=counts.grasp_successes,
        pushes=counts.pushes,
        push_successes=counts.push_successes,
        delivered=counts.delivered,
        refused=counts.refused,
        seconds=counts.seconds,
        table_lift=NAN if level is None else level.lift,
        table_tilt=NAN if level is None else level.tilt,
        left=truth.get("workspace"),
        lost=truth.get("outside"),
        error=counts.error,
        **_found(findings),
    )


def _found(findings: tuple[Finding, ...]) -> dict[str, Any]:
    return {
        "cause": findings[0].cause.value if findings else None,
        "evidence": findings[0].evidence if findings else None,
        "causes": tuple(finding.cause.value for finding in findings),
    }


def _counted(actions: list[ActionRecord]) -> EpisodeResult:
    """What a truncated log's result would have said so far; its reason is not told to anybody."""
    done = [action for action in actions if action.kind != "none"]
    grasps, pushes = ([a for a in done if a.kind == kind] for kind in ("grasp", "push"))
    return EpisodeResult(
        reason=EndReason.FAILED,
        actions=len(done),
        grasps=len(grasps),
        pushes=len(pushes),
        grasp_successes=sum(a.success == "yes" for a in grasps),
        push_successes=sum(a.success == "yes" for a in pushes),
        delivered=0,
        refused=sum(len(a.refusals) for a in actions),
        seconds=NAN,
    )


def _action(name: str, number: int, step: Step, findings: tuple[Finding, ...]) -> ActionRecord:
    outcome = step.outcome
    decision = None if step.intent is None else step.intent.decision
    primitive = None if decision is None else decision.primitive
    verdict = None if decision is None else decision.verdict
    p_foreseen = None if decision is None else decision.p_foreseen
    grasp = outcome if isinstance(outcome, GraspOutcome) else None
    push = outcome if isinstance(outcome, PushOutcome) else None
    return ActionRecord(
        episode=name,
        step=number,
        kind="none" if primitive is None else type(primitive).__name__.lower(),
        success=None if outcome is None else outcome.success.value,
        q=NAN if decision is None else decision.q,
        rotation=None if decision is None else decision.rotation,
        x=NAN if primitive is None else primitive.x,
        y=NAN if primitive is None else primitive.y,
        z=NAN if primitive is None else primitive.z,
        yaw=NAN if primitive is None else primitive.yaw,
        contact=None if outcome is None else outcome.motion.contact,
        seconds=NAN if outcome is None else outcome.motion.seconds,
        width_after_close=NAN if grasp is None else grasp.width_after_close,
        width_after_lift=NAN if grasp is None else grasp.width_after_lift,
        width_at_release=NAN if grasp is None else grasp.width_at_release,
        travelled=NAN if push is None else push.travelled,
        p_success=NAN if verdict is None else max(verdict.p_success, default=NAN),
        overruled=None if verdict is None else verdict.overruled,
        p_foreseen=NAN if p_foreseen is None else p_foreseen,
        decide_seconds=NAN if decision is None else sum(decision.seconds.values()),
        refusals=tuple(refusal_cause(refusal.reason).value for refusal in step.refusals),
        **_found(findings),
    )
