"""What an episode teaches: looks, and transitions with their rewards."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from policies.decide import best_grasps, best_push
from policies.heightmap import Heightmap
from policies.policy import Decision, QMaps
from policies.primitives import Push
from tdpg_deploy.episode import took_goal
from tdpg_deploy.episode_record import EpisodeResult, NullRecorder
from tdpg_deploy.hal import RgbdFrame
from tdpg_deploy.outcome import EndReason, GraspOutcome, Outcome, Verdict
from tdpg_deploy.plan import Plan
from tools.train.config import PushReward
from tools.train.replay import CANDIDATES, TRANSITION, pack_goal, pack_height


@dataclass(frozen=True, kw_only=True, eq=False)
class Experience:
    """heights (n, 224, 224) packed, colors (n, 224, 224, 3); goals (n, 224, 28) packed, None
    where tables are cleared; transitions (m,), whose looks are indices into these."""

    heights: npt.NDArray[np.uint16]
    colors: npt.NDArray[np.uint8]
    goals: npt.NDArray[np.uint8] | None
    transitions: npt.NDArray[np.void]


@dataclass(kw_only=True)
class _Step:
    """An action and what is known of it so far. value: of the best grasp, of the goal if there is
    one, when it was chosen. idle: it moved nothing."""

    transition: npt.NDArray[np.void]
    decision: Decision
    before: Heightmap
    value: float
    idle: bool = False

    @property
    def is_push(self) -> bool:
        return isinstance(self.decision.primitive, Push)

    @property
    def prepares(self) -> bool:
        """Whether it is worth what follows it: a push, or a grasp that clears the way to a goal."""
        goal = self.before.goal
        return self.is_push or not (goal is None or goal[self.decision.row, self.decision.col])


class Notebook(NullRecorder):
    """An EpisodeRecorder that keeps looks and transitions, over any number of episodes.

    actions: concluded so far. A push is written down when what follows it is known: double-step
    learning (paper, section III-C). So is a grasp that clears the way to a goal.
    """

    def __init__(self, reward: PushReward, rng: np.random.Generator) -> None:
        self.actions = 0
        self._reward = reward
        self._rng = rng
        self._heights: list[npt.NDArray[np.uint16]] = []
        self._colors: list[npt.NDArray[np.uint8]] = []
        self._goals: list[npt.NDArray[np.uint8]] = []
        self._transitions: list[npt.NDArray[np.void]] = []
        self._seen: Heightmap | None = None
        self._doing: _Step | None = None  # acted, outcome unknown
        self._last: _Step | None = None  # concluded, what follows unknown

    @property
    def prepared(self) -> bool:
        """Whether the next action of this episode validates the last one."""
        return self._last is not None and self._last.prepares

    def observe(self, frame: RgbdFrame, heightmap: Heightmap) -> None:
        self._seen = heightmap
        self._heights.append(pack_height(heightmap.height))
        self._colors.append(heightmap.color)
        if heightmap.goal is not None:
            self._goals.append(pack_goal(heightmap.goal))

    def intend(self, decision: Decision, plan: Plan, *, stamp: float) -> None:
        assert self._seen is not None
        if self._last is not None:
            self._follow(self._last, decision.maps)
        transition = np.zeros((), TRANSITION)
        transition["look"] = self._latest
        transition["next_look"] = transition["grasped"] = transition["next_push"] = -1
        transition["push"] = isinstance(decision.primitive, Push)
        for name in ("rotation", "row", "col"):
            transition[name] = getattr(decision, name)
        self._doing = _Step(
            transition=transition,
            decision=decision,
            before=self._seen,
            value=float(_of_goal(decision.maps, self._seen).grasp.max()),
        )

    def conclude(self, outcome: Outcome, *, stamp: float) -> None:
        step, self._doing = self._doing, None
        assert step is not None
        self.actions += 1
        success = _taught(outcome)
        step.idle = success is Verdict.NO
        if step.is_push:
            step.transition["reward"] = self._reward.changed * (success is Verdict.YES)
        else:
            if success is not Verdict.UNKNOWN:
                step.transition["grasped"] = success is Verdict.YES
            success = self._fetched(step, success)
            step.transition["reward"] = success is Verdict.YES
        if self._last is not None and self._last.prepares:
            self._validate(self._last, step, success)
        if step.prepares or success is not Verdict.UNKNOWN:
            self._last = step
            if not step.prepares:
                self._transitions.append(step.transition)
        else:
            self._last = None  # nothing to learn from

    def end(self, result: EpisodeResult, *, stamp: float) -> None:
        """Nothing follows the end of a trial; when only the round ends, see `cut_short`."""
        self._doing = None
        if result.reason is EndReason.ACTION_LIMIT:
            return
        if self.prepared and result.reason is not EndReason.DEVICE_ERROR:
            assert self._last is not None
            self._transitions.append(self._last.transition)
        self._last = None

    def cut_short(self, maps: QMaps | None) -> None:
        """A round ends, but not the trial. maps: of the last look, None if nothing was allowed.
        What is not validated is forgotten."""
        if self._last is not None and not self._last.prepares and maps is not None:
            self._follow(self._last, maps)
        self._last = None

    def experience(self) -> Experience:
        """What was learnt; looks that no transition knows are left out."""
        transitions = np.array(self._transitions, TRANSITION)
        known = np.unique(np.concatenate((transitions["look"], transitions["next_look"])))
        known = known[known >= 0]
        for name in ("look", "next_look"):
            found = transitions[name] >= 0
            transitions[name][found] = np.searchsorted(known, transitions[name][found])
        return Experience(
            heights=np.array(self._heights)[known],
            colors=np.array(self._colors)[known],
            goals=np.array(self._goals)[known] if self._goals else None,
            transitions=transitions,
        )

    @property
    def last_seen(self) -> Heightmap:
        assert self._seen is not None
        return self._seen

    @property
    def _latest(self) -> int:
        return len(self._heights) - 1

    def _fetched(self, step: _Step, success: Verdict) -> Verdict:
        """With a goal, a grasp that brought something else earns nothing by itself."""
        if success is not Verdict.YES or step.before.goal is None:
            return success
        fetched = took_goal(step.decision.primitive, step.before, self.last_seen)
        return Verdict.YES if fetched else Verdict.NO

    def _follow(self, step: _Step, maps: QMaps) -> None:
        """Write down which grasps are best now (paper, eq. 1), and whether the best one is
        better than before (eq. 3)."""
        maps = _of_goal(maps, self.last_seen)
        grasps = [(g.rotation, g.row, g.col) for g in best_grasps(maps, self._rng)]
        if grasps:  # repeat the best to fill up: the maximum stays the same
            grasps += [grasps[0]] * (CANDIDATES - len(grasps))
            step.transition["next_look"] = self._latest
            step.transition["next_grasps"] = grasps
            push = best_push(maps, self._rng)
            if push is not None:
                step.transition["next_push"] = push.rotation, push.row, push.col
        if step.prepares and float(maps.grasp.max()) > step.value + self._reward.least_rise:
            step.transition["reward"] += self._reward.rose * self._share(step)

    def _validate(self, before: _Step, step: _Step, success: Verdict) -> None:
        """Reward what prepared a grasp by the grasp that followed (paper, eq. 4)."""
        if success is Verdict.UNKNOWN and not step.is_push:
            return
        if not step.is_push and success is Verdict.YES:
            before.transition["reward"] += self._reward.validated * self._share(before)
        self._transitions.append(before.transition)

    def _share(self, step: _Step) -> float:
        return self._reward.idle if step.idle else 1.0


def _of_goal(maps: QMaps, seen: Heightmap) -> QMaps:
    """Without the grasps that would only clear the way to the goal."""
    if seen.goal is None:
        return maps
    return replace(maps, grasp=np.where(seen.goal, maps.grasp, np.float32(-np.inf)))


def _taught(outcome: Outcome) -> Verdict:
    """Success as a lesson. Pads that hold nothing have failed, even when the map has changed
    there, which the outcome calls unknown: what they knocked over was not grasped."""
    if isinstance(outcome, GraspOutcome) and outcome.held_by_width is Verdict.NO:
        return Verdict.NO
    return outcome.success
