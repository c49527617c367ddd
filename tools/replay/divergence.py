"""What differs between a logged step and the same one decided again: where first, and why."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import zip_longest
from typing import Any

import numpy as np

from policies.heightmap import Heightmap, Workspace
from tdpg_deploy.calibration_file import Calibration
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.episode_log import documents
from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.entries import Candidate, LoggedDecision, PlanDocument
from tdpg_deploy.plan import Plan
from tools.replay.redecide import Proposal, Redecision

TOLERANCE = 0.02  # of action values on another processor: bfloat16 has 8 bits of them


class Stage(Enum):
    """Of one step, in the order in which each rests on the one before."""

    HEIGHTMAP = "heightmap"
    VALUES = "action values"  # Critic I's maps, of which the log has the hash
    VERDICT = "Critic II's verdict"
    ACTION = "action"
    PLAN = "plan"
    COUNT = "number of proposals"


class Cause(Enum):
    """What may explain it. Only that the named thing is another one is certain."""

    CALIBRATION = "calibration"
    CONFIG = "config"
    WEIGHTS = "weights"
    CODE = "code"
    NUMERICS = "numerics"
    UNKNOWN = "unknown"


_EXPLAINS = {
    Stage.HEIGHTMAP: (Cause.CALIBRATION, Cause.CONFIG, Cause.CODE, Cause.NUMERICS),
    Stage.VALUES: (Cause.WEIGHTS, Cause.CODE, Cause.NUMERICS),
    Stage.VERDICT: (Cause.WEIGHTS, Cause.CODE, Cause.NUMERICS),
    Stage.ACTION: (Cause.WEIGHTS, Cause.CODE, Cause.NUMERICS),
    Stage.PLAN: (Cause.CONFIG, Cause.CODE, Cause.NUMERICS),
    Stage.COUNT: (Cause.CONFIG, Cause.WEIGHTS, Cause.CODE, Cause.NUMERICS),
}


@dataclass(frozen=True, kw_only=True)
class Divergence:
    """The first difference of a step.

    found: what differs, with values. cause: the most telling of what is another one than in the
    log and can do this; evidence: all of these, each with both values.
    value_error: largest difference between values of the best actions of each rotation; nan
    where there are none to compare. same_action: whether the same action is chosen all the same.
    """

    number: int
    stage: Stage
    found: str
    cause: Cause
    evidence: tuple[str, ...]
    value_error: float
    same_action: bool

    @property
    def within_tolerance(self) -> bool:
        """Whether another processor may do this: the same action by values almost the same."""
        return self.same_action and self.value_error <= TOLERANCE


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """All but the logged frames that a decision rests on."""

    cell: CellConfig
    policy: str
    checkpoint_sha256: str | None
    commit: str | None
    versions: Mapping[str, str]

    @classmethod
    def of(cls, about: About) -> Surroundings:
        return cls(
            cell=about.cell,
            policy=about.policy,
            checkpoint_sha256=about.checkpoint_sha256,
            commit=about.commit,
            versions=about.versions,
        )


def first_divergence(
    step: Redecision, logged: Surroundings, again: Surroundings
) -> Divergence | None:
    """None if the step is the same, bit for bit, or its look is lost."""
    if step.rebuilt is None:
        return None
    found = _first_difference(step)
    if found is None:
        return None
    stage, what = found
    differences = differing(logged, again)
    causes = [cause for cause in _EXPLAINS[stage] if cause in differences]
    last = (
        (step.logged[-1].decision, step.again[-1].decision) if step.logged and step.again else None
    )
    return Divergence(
        number=step.number,
        stage=stage,
        found=what,
        cause=causes[0] if causes else Cause.UNKNOWN,
        evidence=tuple(line for cause in causes for line in differences[cause]),
        value_error=float("nan") if last is None else value_error(*last),
        same_action=last is not None and last[0].primitive == last[1].primitive,
    )


# --- what differs -----------------------------------------------------------------------------


def _first_difference(step: Redecision) -> tuple[Stage, str] | None:
    assert step.rebuilt is not None
    assert step.step.look is not None
    map_differs = heightmap_difference(step.step.look.heightmap, step.rebuilt)
    if map_differs is not None:
        return Stage.HEIGHTMAP, map_differs
    for logged, again in zip_longest(step.logged, step.again):
        found = _difference(logged, again)
        if found is not None:
            return found
    return None


def heightmap_difference(logged: Heightmap, again: Heightmap) -> str | None:
    """Of where they lie, of heights and of colours; None if they are the same bit for bit. The
    goal is taken from the log and not compared."""
    if logged.workspace != again.workspace:
        return f"it covers {_square(again.workspace)}, in the log {_square(logged.workspace)}"
    known = logged.valid & again.valid
    unlike = known & (logged.height != again.height)
    appeared, vanished = (again.valid & ~known).sum(), (logged.valid & ~known).sum()
    colors = (logged.color != again.color).any(axis=-1)
    if not (unlike.any() or appeared or vanished or colors.any()):
        return None
    most = float(np.abs(logged.height - again.height)[unlike].max(initial=0.0))
    found = [
        (unlike.sum(), f"heights differ, by up to {1000 * most:.3g} mm"),
        (appeared, "pixels are seen that were not"),
        (vanished, "pixels are seen no more"),
        (colors.sum(), "colours differ"),
    ]
    return "; ".join(f"{count} {what}" for count, what in found if count)


def _square(workspace: Workspace) -> str:
    w = workspace
    return (
        f"x {w.x_min:.4g} to {w.x_max:.4g}, y {w.y_min:.4g} to {w.y_max:.4g} m, "
        f"table at {w.table_z:.4g} m"
    )


def _difference(logged: Proposal | None, again: Proposal | None) -> tuple[Stage, str] | None:
    if logged is None:
        return Stage.COUNT, "one more action is proposed than was logged"
    if again is None:
        return Stage.COUNT, "no further action is proposed, though one was logged"
    then, now = logged.decision, again.decision
    if then.maps_sha256 != now.maps_sha256:
        error = value_error(then, now)
        return Stage.VALUES, f"values of best actions differ by up to {error:.3g}"
    if then.verdict != now.verdict:
        return Stage.VERDICT, f"{now.verdict}, in the log {then.verdict}"
    if (then.primitive, then.rotation, then.row, then.col, then.q) != (
        now.primitive, now.rotation, now.row, now.col, now.q,
    ):  # fmt: skip
        return Stage.ACTION, f"{now.primitive}, in the log {then.primitive}"
    if logged.refusal != again.refusal:
        return Stage.PLAN, f"{again.refusal or 'not refused'}, in the log {logged.refusal}"
    if _document(logged.plan) != _document(again.plan):
        return Stage.PLAN, "the same action is planned in another way"
    return None


def _document(plan: Plan | None) -> bytes | None:
    """As it comes out of a log: a pose's quaternion is normalised when it is read."""
    if plan is None:
        return None
    written = documents.encode(PlanDocument(plan=plan, stamp=0.0))
    return documents.encode(documents.decode(PlanDocument, written))


def value_error(logged: LoggedDecision, again: LoggedDecision) -> float:
    """Largest difference between values of the best actions of the same kind and rotation; nan
    if they have none in common."""
    errors = [
        abs(then[rotation].q - now[rotation].q)
        for then, now in (
            (_by_rotation(logged.pushes), _by_rotation(again.pushes)),
            (_by_rotation(logged.grasps), _by_rotation(again.grasps)),
        )
        for rotation in then.keys() & now.keys()
    ]
    return max(errors, default=float("nan"))


def _by_rotation(candidates: tuple[Candidate, ...]) -> dict[int, Candidate]:
    return {candidate.rotation: candidate for candidate in candidates}


# --- why --------------------------------------------------------------------------------------


def differing(logged: Surroundings, again: Surroundings) -> dict[Cause, list[str]]:
    """What is another one than in the log, each with both values."""
    lines = {
        Cause.CALIBRATION: list(_calibration(logged.cell, again.cell)),
        Cause.CONFIG: list(_config(logged.cell, again.cell)),
        Cause.WEIGHTS: list(_weights(logged, again)),
        Cause.CODE: list(_code(logged, again)),
        Cause.NUMERICS: list(_versions(logged.versions, again.versions)),
    }
    return {cause: found for cause, found in lines.items() if found}


def _calibration(logged: CellConfig, again: CellConfig) -> Iterator[str]:
    distance, angle = logged.X_base_camera.distance(again.X_base_camera)
    if logged.camera.X_base_camera != again.camera.X_base_camera:
        yield (
            f"X_base_camera is {1000 * distance:.2f} mm and {np.degrees(angle):.3f} deg from "
            "the logged one"
        )
    then, now = logged.camera.calibration, again.camera.calibration
    if then != now:
        yield f"the calibration file is {_described(now)}, in the log {_described(then)}"


def _described(calibration: Calibration | None) -> str:
    if calibration is None:
        return "none"
    text, depth = f"that of {calibration.date.isoformat(' ', 'minutes')}", calibration.depth
    if depth is None:
        return text
    return f"{text} (depth: a = {depth.a:.6g}, b = {depth.b:.3g} 1/m)"


def _config(logged: CellConfig, again: CellConfig) -> Iterator[str]:
    then, now = _leaves(logged.model_dump()), _leaves(again.model_dump())
    for name in sorted(then.keys() | now.keys()):
        if name.startswith(("camera.X_base_camera", "camera.calibration")):
            continue
        if then.get(name) != now.get(name):
            yield f"{name} is {now.get(name)}, in the log {then.get(name)}"


def _leaves(section: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    leaves: dict[str, Any] = {}
    for name, value in section.items():
        if isinstance(value, dict):
            leaves |= _leaves(value, f"{prefix}{name}.")
        else:
            leaves[f"{prefix}{name}"] = value
    return leaves


def _weights(logged: Surroundings, again: Surroundings) -> Iterator[str]:
    then, now = logged.checkpoint_sha256, again.checkpoint_sha256
    if then != now:
        yield (
            f"checkpoint {(now or 'none')[:12]} ({again.policy}), in the log "
            f"{(then or 'none')[:12]} ({logged.policy})"
        )
    elif then is None and logged.policy != again.policy:
        yield f"policy {again.policy}, in the log {logged.policy}"


def _code(logged: Surroundings, again: Surroundings) -> Iterator[str]:
    then, now = logged.commit, again.commit
    if then != now:
        yield f"commit {now}, in the log {then}"
    elif now is not None and now.endswith("-dirty"):
        yield f"both ran from altered copies of commit {now.removesuffix('-dirty')}"


def _versions(logged: Mapping[str, str], again: Mapping[str, str]) -> Iterator[str]:
    for name in sorted(logged.keys() & again.keys()):
        if logged[name] != again[name]:
            yield f"{name} {again[name]}, in the log {logged[name]}"
