"""The loop: look, decide, plan, check, say so, act, look again, conclude. The same for
training, evaluation, the simulated and the real cell.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from policies.heightmap import Heightmap
from policies.policy import Decider, Decision
from policies.primitives import Grasp, Primitive
from tdpg_deploy.cell import Cell
from tdpg_deploy.change import changed, gone
from tdpg_deploy.choosing import Chooser, is_seen
from tdpg_deploy.episode_record import EpisodeRecorder, EpisodeResult
from tdpg_deploy.errors import ConfigError, DeviceError, LogError
from tdpg_deploy.execution import execute, held, make_ready
from tdpg_deploy.outcome import EndReason, GraspOutcome, Outcome, Verdict
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.plan import Plan
from tdpg_deploy.workspace import workspace_of

Confirm = Callable[[Decision, Plan], bool]

OBJECT_RISE = 0.01  # m; no block is thinner than 25 mm
OBJECT_PIXELS = 100  # the smallest face of a block has 312
MOSTLY_KNOWN = 0.8  # share of the map to be known before an empty table is believed
BARELY_KNOWN = 0.5
MAX_SEARCHES = 5  # actions in a row for a goal that was seen and is hidden now


def run_episode(
    cell: Cell,
    policy: Decider,
    *,
    rng: np.random.Generator,
    log: EpisodeRecorder,
    goal: bool = False,
    confirm: Confirm | None = None,
) -> EpisodeResult:
    """Act until an EndReason holds. `cell` is connected.

    goal: fetch the object that `cell.goal_pixels` shows, then stop; raises ConfigError where the
    cell has no such thing.
    confirm: asked before each action; a no ends the episode as the operator's stop.

    A device error or Ctrl-C ends the episode too: the arm is stopped and the result says so.
    Anything else, such as a full disk under the log, stops the arm, ends the log and is raised.
    """
    if goal and cell.goal_pixels is None:
        raise ConfigError("no goal: nothing tells this cell which pixels show the object to fetch")
    chooser = Chooser(policy, cell.config, rng)
    episode = _Episode(cell=cell, chooser=chooser, log=log, goal=goal, confirm=confirm)
    try:
        result = episode.result(episode.run())
    except KeyboardInterrupt:
        _stop(cell)
        result = episode.result(EndReason.OPERATOR_STOP)
    except DeviceError as error:
        _stop(cell)
        result = episode.result(EndReason.DEVICE_ERROR, error=f"{type(error).__name__}: {error}")
    except BaseException as error:
        _stop(cell)
        failed = episode.result(EndReason.FAILED, error=f"{type(error).__name__}: {error}")
        with suppress(LogError):  # the first error is the one to report
            log.end(failed, stamp=cell.clock.now())
        raise
    log.end(result, stamp=cell.clock.now())
    return result


def _stop(cell: Cell) -> None:
    with suppress(DeviceError):
        cell.arm.stop()


@dataclass(kw_only=True)
class _Counts:
    actions: int = 0
    grasps: int = 0
    pushes: int = 0
    grasp_successes: int = 0
    push_successes: int = 0
    delivered: int = 0
    refused: int = 0
    failures_in_a_row: int = 0

    def add(self, outcome: Outcome, max_width: float) -> None:
        success = outcome.success is Verdict.YES
        self.actions += 1
        self.failures_in_a_row = 0 if success else self.failures_in_a_row + 1
        if isinstance(outcome, GraspOutcome):
            self.grasps += 1
            self.grasp_successes += success
            self.delivered += held(outcome.width_at_release, max_width) is Verdict.YES
        else:
            self.pushes += 1
            self.push_successes += success


@dataclass(kw_only=True)
class _Episode:
    cell: Cell
    chooser: Chooser
    log: EpisodeRecorder
    goal: bool
    confirm: Confirm | None
    counts: _Counts = field(default_factory=_Counts)
    fetched_goal: bool = False
    hidden_for: int = 0  # looks in a row that did not show the goal

    def __post_init__(self) -> None:
        self.started = self.cell.clock.now()

    def run(self) -> EndReason:
        make_ready(self.cell, on_state=self.log.arm_state, on_gripper=self.log.gripper_state)
        seen = self.look()
        while (reason := self.end_reason(seen)) is None:
            chosen = self.chooser.choose(seen, self.refused)
            if chosen is None:
                return EndReason.GOAL_LOST if self.hidden_for else EndReason.NO_ACTION
            decision, plan = chosen
            if self.confirm is not None and not self.confirm(decision, plan):
                return EndReason.OPERATOR_STOP
            seen = self.act(decision, plan, seen)
        return reason

    def look(self) -> Heightmap:
        cell, config = self.cell, self.cell.config
        frame, workspace = cell.camera.capture(), workspace_of(config)
        goal = cell.goal_pixels(frame) if self.goal and cell.goal_pixels is not None else None
        heightmap = build_heightmap(frame, config.X_base_camera, workspace, goal_pixels=goal)
        self.log.observe(frame, heightmap)
        hidden = heightmap.goal is not None and not is_seen(heightmap.goal)
        self.hidden_for = self.hidden_for + 1 if hidden else 0
        return heightmap

    def end_reason(self, seen: Heightmap) -> EndReason | None:
        if self.fetched_goal:
            return EndReason.GOAL_REACHED
        known = float(seen.valid.mean())
        if known < BARELY_KNOWN:
            return EndReason.NOTHING_SEEN
        if not has_objects(seen):
            return EndReason.CLEARED if known >= MOSTLY_KNOWN else EndReason.NOTHING_SEEN
        if self.hidden_for > (MAX_SEARCHES if self.counts.actions else 0):
            return EndReason.GOAL_LOST
        limits = self.cell.config.episode
        if self.counts.failures_in_a_row >= limits.max_failures:
            return EndReason.STUCK
        return EndReason.ACTION_LIMIT if self.counts.actions >= limits.max_actions else None

    def refused(self, decision: Decision, reason: str) -> None:
        self.log.refused(decision, reason, stamp=self.cell.clock.now())
        self.counts.refused += 1

    def act(self, decision: Decision, plan: Plan, before: Heightmap) -> Heightmap:
        """Run the plan, look again and conclude. Returns what is seen now."""
        cell, log = self.cell, self.log
        log.intend(decision, plan, stamp=cell.clock.now())
        outcome = execute(plan, cell, on_state=log.arm_state, on_gripper=log.gripper_state)
        after = self.look()
        outcome = witnessed(outcome, plan.primitive, before, after)
        log.conclude(outcome, stamp=cell.clock.now())
        self.counts.add(outcome, cell.gripper.max_width)
        self.chooser.learn(plan.primitive, outcome, before, after)
        if outcome.success is Verdict.YES:
            self.fetched_goal = self.goal and took_goal(plan.primitive, before, after)
        return after

    def result(self, reason: EndReason, *, error: str | None = None) -> EpisodeResult:
        counts, cell = self.counts, self.cell
        return EpisodeResult(
            reason=reason,
            actions=counts.actions,
            grasps=counts.grasps,
            pushes=counts.pushes,
            grasp_successes=counts.grasp_successes,
            push_successes=counts.push_successes,
            delivered=counts.delivered,
            refused=counts.refused,
            seconds=cell.clock.now() - self.started,
            error=error,
            truth=None if cell.truth is None else cell.truth(),
        )


# --- judgements -------------------------------------------------------------------------------


def witnessed(
    outcome: Outcome, primitive: Primitive, before: Heightmap, after: Heightmap
) -> Outcome:
    """The outcome with what the heightmaps say of it. A goal that is held and no longer seen is
    gone, whatever rose or rolled into its place."""
    if isinstance(outcome, GraspOutcome):
        if outcome.held_by_width is Verdict.YES and took_goal(primitive, before, after):
            return replace(outcome, gone_from_map=Verdict.YES)
        return replace(outcome, gone_from_map=gone(before, after, primitive))
    return replace(outcome, changed=changed(before, after, primitive))


def has_objects(heightmap: Heightmap) -> bool:
    """Whether something is seen to rise above the table. Says nothing of what is unknown."""
    with np.errstate(invalid="ignore"):
        return int((heightmap.height > OBJECT_RISE).sum()) >= OBJECT_PIXELS


def took_goal(primitive: Primitive, before: Heightmap, after: Heightmap) -> bool:
    """Whether an action was a grasp on the goal, and the goal is no longer seen."""
    if not isinstance(primitive, Grasp) or before.goal is None or after.goal is None:
        return False
    row, col = before.workspace.to_pixel(primitive.x, primitive.y)
    return bool(before.goal[row, col]) and is_seen(before.goal) and not is_seen(after.goal)
