"""Decide again on what was logged: frames -> heightmaps -> actions, by the lines that the episode
ran through.

With the policy of the log this is a test: the same heightmaps and actions, bit for bit. With
another policy, calibration or cell file it tells what would have been done.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from policies.heightmap import Heightmap
from policies.policy import Decider, Decision
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.choosing import Chooser
from tdpg_deploy.episode_log.entries import LoggedDecision, Look, Step
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.geometry import Transform
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.plan import Plan
from tdpg_deploy.workspace import workspace_of

BETWEEN = 5  # pixels of a 720p frame at 0.8 m in two of a heightmap


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A decision and what became of it: a plan, or the reason why there is none."""

    decision: LoggedDecision
    plan: Plan | None
    refusal: str | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Redecision:
    """One step of a log, decided again.

    logged, again: proposals in order; all but the last were refused, the last too if no action
    was left. rebuilt: the heightmap made of the logged frame again. seen: the one decided on.
    Where the look is lost, nothing can be seen or proposed again.
    """

    number: int
    step: Step
    logged: tuple[Proposal, ...]
    again: tuple[Proposal, ...]
    rebuilt: Heightmap | None
    seen: Heightmap | None


def redecide(
    episode: Episode, policy: Decider, config: CellConfig | None = None
) -> Iterator[Redecision]:
    """Each step of the log again, in order, as its generator and its memory of futile actions go
    from one to the next.

    config: another cell than the log's, with another calibration or workspace; decisions are then
    made on the rebuilt heightmaps, else on the logged ones, so that a difference in perception
    does not hide one in the policy. Raises LogError at damage, after all that lies before it.
    """
    about = episode.about
    rng = np.random.default_rng(0 if about.seed is None else about.seed)
    chooser = Chooser(policy, config or about.cell, rng)
    eyes = _Eyes(about.cell, config)
    for number, step in enumerate(episode.steps(states=False), start=1):
        rebuilt, seen = (None, None) if step.look is None else eyes.look(step.look)
        yield Redecision(
            number=number,
            step=step,
            logged=proposals_of(step),
            again=() if seen is None else _propose(chooser, seen),
            rebuilt=rebuilt,
            seen=seen,
        )
        if seen and step.intent and step.outcome and step.next_look:
            _, after = eyes.look(step.next_look)
            chooser.learn(step.intent.decision.primitive, step.outcome, seen, after)


def proposals_of(step: Step) -> tuple[Proposal, ...]:
    """What was decided in this step, in order."""
    refused = [
        Proposal(decision=refusal.decision, plan=None, refusal=refusal.reason)
        for refusal in step.refusals
    ]
    if step.intent is None:
        return tuple(refused)
    return *refused, Proposal(decision=step.intent.decision, plan=step.intent.plan, refusal=None)


def _propose(chooser: Chooser, seen: Heightmap) -> tuple[Proposal, ...]:
    proposals: list[Proposal] = []

    def refused(decision: Decision, reason: str) -> None:
        logged = LoggedDecision.of(decision)
        proposals.append(Proposal(decision=logged, plan=None, refusal=reason))

    chosen = chooser.choose(seen, refused)
    if chosen is not None:
        decision, plan = chosen
        logged = LoggedDecision.of(decision)
        proposals.append(Proposal(decision=logged, plan=plan, refusal=None))
    return tuple(proposals)


class _Eyes:
    """Looks -> the rebuilt heightmap, and the one to decide on. Keeps the last one: what was seen
    after an action is what the next decision is made on."""

    def __init__(self, logged: CellConfig, other: CellConfig | None) -> None:
        self._logged = logged
        self._other = other
        self._last: tuple[Look, Heightmap, Heightmap] | None = None

    def look(self, look: Look) -> tuple[Heightmap, Heightmap]:
        if self._last is None or self._last[0] is not look:
            config = self._other or self._logged
            rebuilt = build_heightmap(
                look.frame,
                config.X_base_camera,
                workspace_of(config),
                goal_pixels=goal_pixels(look, self._logged.X_base_camera),
            )
            seen = look.heightmap if self._other is None else rebuilt
            self._last = look, rebuilt, seen
        return self._last[1:]


def goal_pixels(look: Look, X_base_camera: Transform) -> npt.NDArray[np.bool_] | None:
    """(H, W) of the frame, where it shows the goal; None without one.

    The log has the goal as pixels of the heightmap. A picture whose colours number its own pixels
    is made into a heightmap: it tells which pixel of the frame each of them came from. Those are
    some of the goal's; what lies between them is the goal too.
    """
    goal = look.heightmap.goal
    if goal is None:
        return None
    shape = look.frame.depth.shape
    numbers = np.arange(look.frame.depth.size)
    colors = np.stack([numbers >> shift & 255 for shift in (16, 8, 0)], axis=-1).astype(np.uint8)
    numbered = replace(look.frame, color=colors.reshape(*shape, 3))
    found = build_heightmap(numbered, X_base_camera, look.heightmap.workspace).color[goal]
    shown = np.zeros(numbers.size, np.uint8)
    shown[found.astype(np.intp) @ (1 << 16, 1 << 8, 1)] = 1
    shown[0] = 0  # what is unseen now is black, too
    closed = cv2.morphologyEx(
        shown.reshape(shape), cv2.MORPH_CLOSE, np.ones((BETWEEN, BETWEEN), np.uint8)
    )
    return closed.astype(np.bool_)
