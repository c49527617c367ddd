"""What an episode's page shows of each step, as plain JSON values. Pure.

Places are in pixels of the heightmap (column, row; 224 a side), heights in mm above the table,
times in seconds since the action was intended.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np

from policies.heightmap import PIXEL, Workspace
from policies.primitives import Primitive, Push
from tdpg_deploy import kinematics
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode_log.entries import Candidate, LoggedDecision, Step, ToolPoint
from tdpg_deploy.outcome import GraspOutcome, Outcome
from tdpg_deploy.plan import MoveFingers, MoveJoints, MoveLinear, Plan
from tdpg_deploy.workspace import workspace_of
from tools.audit.actions import refusal_cause
from tools.audit.causes import Finding

SAMPLES = 120  # of a step's states that are drawn
CANDIDATES = 16  # best actions that are marked on the map


def step_data(step: Step, findings: tuple[Finding, ...], cell: CellConfig) -> dict[str, Any]:
    workspace = workspace_of(cell)
    data: dict[str, Any] = {
        "kind": "none",
        "success": None if step.outcome is None else step.outcome.success.value,
        "findings": findings_data(findings),
        "refusals": [
            {"cause": refusal_cause(refusal.reason).value, "reason": refusal.reason}
            for refusal in step.refusals
        ],
        "look": None if step.seen is None else str(step.seen.sequence),
        "after": None if step.next_seen is None else str(step.next_seen.sequence),
    }
    if step.intent is None:
        return data
    decision, plan = step.intent.decision, step.intent.plan
    verdict = decision.verdict
    data |= {
        "kind": type(decision.primitive).__name__.lower(),
        "action": _action(decision.primitive, workspace),
        "q": number(decision.q),
        "rotation": decision.rotation,
        "candidates": _candidates(decision.pushes, "push") + _candidates(decision.grasps, "grasp"),
        "verdict": None
        if verdict is None
        else {
            "p": [number(p) for p in verdict.p_success],
            "overruled": verdict.overruled,
        },
        "decided_in": {name: number(seconds) for name, seconds in decision.seconds.items()},
        "notes": [*plan.notes, *_foreseen(decision)],
        "plan": _plan(plan, cell, workspace),
        "limits": _limits(plan),
        "path": _path(step.tool_path, step.intent.stamp, workspace),
        "widths": [
            [number(state.stamp - step.intent.stamp), number(1000 * state.width)]
            for state in step.gripper_states
        ],
        "outcome": _outcome(step.outcome),
    }
    return data


def _foreseen(decision: LoggedDecision) -> list[str]:
    p = decision.p_foreseen
    return [] if p is None else [f"foreseen to work: {p:.0%}"]


def findings_data(findings: tuple[Finding, ...]) -> list[dict[str, str]]:
    return [{"cause": one.cause.value, "evidence": one.evidence} for one in findings]


def number(value: float | None, digits: int = 4) -> float | None:
    """Rounded; None where JSON has no number for it."""
    return None if value is None or not isfinite(value) else round(float(value), digits)


def _pixel(x: float, y: float, workspace: Workspace) -> list[float | None]:
    """x, y in base -> column, row, from the map's corner."""
    return [
        number((workspace.y_max - y) / PIXEL, 2),
        number((workspace.x_max - x) / PIXEL, 2),
    ]


def _action(primitive: Primitive, workspace: Workspace) -> dict[str, Any]:
    return {
        "at": _pixel(primitive.x, primitive.y, workspace),
        "yaw": number(primitive.yaw),
        "length": primitive.length / PIXEL if isinstance(primitive, Push) else None,
        "place": [number(primitive.x), number(primitive.y), number(primitive.z)],
    }


def _candidates(candidates: Sequence[Candidate], kind: str) -> list[dict[str, Any]]:
    best = sorted(candidates, key=lambda candidate: -candidate.q)[:CANDIDATES]
    return [
        {"kind": kind, "q": number(c.q), "at": [c.col + 0.5, c.row + 0.5], "rotation": c.rotation}
        for c in best
    ]


def _plan(plan: Plan, cell: CellConfig, workspace: Workspace) -> list[dict[str, Any]]:
    X_flange_tool = cell.arm.X_flange_tool.transform()
    steps: list[dict[str, Any]] = []
    for step in (*plan.approach, *plan.delivery, *plan.retreat):
        if isinstance(step, MoveFingers):
            steps.append({"name": step.name, "width": number(1000 * step.width, 1)})
            continue
        pose = (
            kinematics.forward(cell.arm.dh, step.q, X_flange_tool)
            if isinstance(step, MoveJoints)
            else step.X_base_tool
        )
        x, y, z = pose.translation
        height = number(1000 * (z - workspace.table_z), 1)
        steps.append({"name": step.name, "at": _pixel(x, y, workspace), "height": height})
    return steps


def _limits(plan: Plan) -> dict[str, float]:
    """Newtons at which guarded steps stop, by the step's name."""
    return {
        step.name: step.stop_force
        for step in plan.approach
        if isinstance(step, MoveLinear) and step.stop_force is not None
    }


def _path(path: Sequence[ToolPoint], start: float, workspace: Workspace) -> dict[str, Any]:
    """Samples of the way, the peak of force among them, as columns."""
    chosen: set[int] = set()
    if path:
        strongest = max(range(len(path)), key=lambda i: path[i].force)
        chosen = {strongest, *np.linspace(0, len(path) - 1, SAMPLES).astype(int).tolist()}
    points = [path[i] for i in sorted(chosen)]
    return {
        "t": [number(point.stamp - start, 3) for point in points],
        "force": [number(point.force, 2) for point in points],
        "height": [number(1000 * (point.p_base[2] - workspace.table_z), 1) for point in points],
        "at": [_pixel(point.p_base[0], point.p_base[1], workspace) for point in points],
    }


def _outcome(outcome: Outcome | None) -> dict[str, Any] | None:
    if outcome is None:
        return None
    data: dict[str, Any] = {
        "contact": outcome.motion.contact,
        "seconds": number(outcome.motion.seconds, 2),
    }
    if isinstance(outcome, GraspOutcome):
        return data | {
            "held by width": outcome.held_by_width.value,
            "gone from map": outcome.gone_from_map.value,
            "width after close": _mm(outcome.width_after_close),
            "width after lift": _mm(outcome.width_after_lift),
            "width at release": _mm(outcome.width_at_release),
        }
    return data | {"map changed": outcome.changed.value, "travelled": _mm(outcome.travelled)}


def _mm(metres: float) -> str | None:
    return f"{abs(1000 * metres):.1f} mm" if isfinite(metres) else None
