"""Two sets of episodes, before and after a change: differences with 95 % intervals. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tools.audit.tally import Tally
from tools.evaluate.metrics import Estimate, Metrics, evaluate, share


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One figure of both sets. is_clear: the interval of the difference leaves zero out."""

    name: str
    one: Estimate
    other: Estimate
    difference: Estimate

    @property
    def is_clear(self) -> bool:
        return self.difference.low > 0 or self.difference.high < 0


def compare(one: Tally, other: Tally) -> list[Comparison]:
    """The metrics of complete logs, then the share of actions that failed of each cause."""
    before, after = figures(evaluate(one.rows)), figures(evaluate(other.rows))
    rows = [_compare(name, before[name], after[name]) for name in before]
    for cause in sorted(one.failures.counts.keys() | other.failures.counts.keys()):
        shares = [share(tally.failures.counts[cause], tally.actions) for tally in (one, other)]
        rows.append(_compare(cause, *shares))
    return rows


def figures(metrics: Metrics) -> dict[str, Estimate]:
    """By name; all but motions are shares. Of all episodes, and of those that were completed."""
    every, completed = metrics.of_all, metrics.of_completed
    return {
        "completion": metrics.completion,
        "grasp success": every.grasp_success,
        "action efficiency": every.action_efficiency,
        "motions": every.motions,
        "grasp success, completed": completed.grasp_success,
        "action efficiency, completed": completed.action_efficiency,
        "motions, completed": completed.motions,
    }


def difference(one: Estimate, other: Estimate) -> Estimate:
    """other - one, its interval made of theirs: the square-and-add rule of Newcombe (1998), as
    Zou and Donner (2008) take it to any two independent estimates."""
    value = other.value - one.value
    return Estimate(
        value=value,
        low=value - math.hypot(other.value - other.low, one.high - one.value),
        high=value + math.hypot(other.high - other.value, one.value - one.low),
    )


def _compare(name: str, one: Estimate, other: Estimate) -> Comparison:
    return Comparison(name=name, one=one, other=other, difference=difference(one, other))
