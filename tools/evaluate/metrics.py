"""The paper's four metrics (section IV), with 95 % intervals: the one place that computes them.

Every figure is given twice: over completed episodes, as the papers define it, and over all
episodes, which does not forget the failures.

scipy.stats takes half a second to import: it is left to the functions, for those who want rows.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tdpg_deploy.outcome import EndReason

BATCH = 1_000_000  # resampled values in memory, however many episodes there are
COMPLETED = (EndReason.CLEARED, EndReason.GOAL_REACHED)


@dataclass(frozen=True, kw_only=True)
class EpisodeRow:
    """One episode, by what was measured.

    objects: how many were to be lifted: all at the start, or the one goal. goal: whether one
    object was to be fetched. lifted: of each action, whether it was a successful grasp.
    """

    scene: str
    seed: int
    reason: EndReason
    objects: int
    actions: int
    grasps: int
    grasp_successes: int
    goal: bool = False
    lifted: tuple[bool, ...] = ()

    @property
    def completed(self) -> bool:
        return self.reason in COMPLETED

    @property
    def cleared(self) -> int:
        """Objects that count for efficiency: all of a completed table, else what was lifted.
        A goal that was not fetched is none, whatever was lifted from above it."""
        if self.completed:
            return self.objects
        return 0 if self.goal else self.grasp_successes


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A mean and its 95 % interval; nan where no episode counts."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Figures:
    """grasp_success: mean over episodes of successful grasps / grasps.
    action_efficiency: mean over episodes of objects cleared / actions; over 1 where one grasp
    lifted two.
    motions: mean number of actions."""

    episodes: int
    grasp_success: Estimate
    action_efficiency: Estimate
    motions: Estimate


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """completion: share of episodes that were completed (Wilson's interval).
    of_completed: the papers' definition. of_all: every episode."""

    completion: Estimate
    of_completed: Figures
    of_all: Figures
    reasons: dict[EndReason, int]


def evaluate(rows: Sequence[EpisodeRow]) -> Metrics:
    """Metrics of a set of episodes. Raises ValueError for an empty set."""
    if not rows:
        raise ValueError("no episodes to evaluate")
    completed = [row for row in rows if row.completed]
    return Metrics(
        completion=share(len(completed), len(rows)),
        of_completed=_figures(completed),
        of_all=_figures(rows),
        reasons=dict(Counter(row.reason for row in rows)),
    )


def share(count: int, total: int) -> Estimate:
    """With Wilson's interval; nan of nothing."""
    from scipy.stats import binomtest

    if total == 0:
        return Estimate(value=math.nan, low=math.nan, high=math.nan)
    result = binomtest(count, total)
    interval = result.proportion_ci(0.95, method="wilson")
    return Estimate(value=result.statistic, low=interval.low, high=interval.high)


def _figures(rows: Sequence[EpisodeRow]) -> Figures:
    return Figures(
        episodes=len(rows),
        grasp_success=_mean([row.grasp_successes / row.grasps for row in rows if row.grasps]),
        action_efficiency=_mean([row.cleared / row.actions for row in rows if row.actions]),
        motions=_mean([float(row.actions) for row in rows]),
    )


def _mean(values: Sequence[float]) -> Estimate:
    """Mean with a bootstrapped interval (BCa, 2,000 resamples, seeded)."""
    from scipy.stats import bootstrap

    if not values:
        return Estimate(value=math.nan, low=math.nan, high=math.nan)
    mean = float(np.mean(values))
    if np.ptp(values) == 0:  # nothing to resample
        return Estimate(value=mean, low=mean, high=mean)
    interval = bootstrap(
        (np.asarray(values),),
        np.mean,
        n_resamples=2000,
        batch=max(1, BATCH // len(values)),
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Estimate(value=mean, low=float(interval.low), high=float(interval.high))
