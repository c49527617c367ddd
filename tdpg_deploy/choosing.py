"""From a look to an action: the best one whose plan passes, and not again what was futile.

Apart from the loop, so that a logged episode can be decided again by the same lines.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from policies.errors import NoActionError
from policies.heightmap import Heightmap
from policies.policy import Decider, Decision
from policies.primitives import Primitive
from policies.standing import Mask, within
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.change import changed
from tdpg_deploy.errors import PlanRefused
from tdpg_deploy.foresight.policy import with_foresight
from tdpg_deploy.motion import DESCENT, plan_primitive
from tdpg_deploy.outcome import Outcome, Verdict
from tdpg_deploy.plan import Plan
from tdpg_deploy.safety import check

OnRefused = Callable[[Decision, str], None]

GOAL_PIXELS = 30  # of the heightmap: of which less is seen, a goal is hidden
SEARCHED = 0.03  # m around where a goal was last seen
MAX_REFUSALS = 100  # per look: behind a tall block many of the best need unseen ground


@dataclass(frozen=True, kw_only=True, eq=False)
class _Futile:
    """An action that failed and moved nothing, or that ended on its way down, whatever it shook
    there: not to be tried again until the map changes."""

    primitive: Primitive
    seen: Heightmap


class Chooser:
    """The same looks, outcomes, policy, cell and generator state give the same choices."""

    def __init__(self, policy: Decider, config: CellConfig, rng: np.random.Generator) -> None:
        self._policy = with_foresight(policy, config)
        self._config = config
        self._rng = rng
        self._futile: list[_Futile] = []
        self._goal_place: Mask | None = None  # where it was last seen

    def choose(self, seen: Heightmap, on_refused: OnRefused) -> tuple[Decision, Plan] | None:
        """The best action whose plan passes; None when there is none.

        on_refused: told every decision whose plan does not pass, and why.
        """
        seen = self._searched(seen)
        refused: list[Primitive] = []
        while len(refused) < MAX_REFUSALS:
            decision = self._decide(seen, refused)
            if decision is None:
                return None
            try:
                plan = plan_primitive(decision.primitive, seen, self._config)
                check(plan, self._config)
            except PlanRefused as error:
                on_refused(decision, str(error))
                refused.append(decision.primitive)
            else:
                return decision, plan
        return None

    def learn(
        self, primitive: Primitive, outcome: Outcome, before: Heightmap, after: Heightmap
    ) -> None:
        """What an action did, by what was seen before and after."""
        self._futile = [
            action
            for action in self._futile
            if changed(action.seen, after, action.primitive) is not Verdict.YES
        ]
        if outcome.motion.contact in DESCENT:
            self._futile.append(_Futile(primitive=primitive, seen=after))
        elif (
            outcome.success is not Verdict.YES
            and changed(before, after, primitive) is not Verdict.YES
        ):
            self._futile.append(_Futile(primitive=primitive, seen=before))

    def _searched(self, seen: Heightmap) -> Heightmap:
        """As it was seen, or while the goal is hidden: what stands where it was last seen is to be
        taken away like a goal."""
        if seen.goal is None:
            return seen
        if seen.goal.any():
            self._goal_place = seen.goal
        if is_seen(seen.goal) or self._goal_place is None:
            return seen
        return replace(seen, goal=within(SEARCHED, self._goal_place))

    def _decide(self, seen: Heightmap, refused: list[Primitive]) -> Decision | None:
        """None when nothing is left. What was futile comes last, for the stuck guard to end."""
        avoid = [*refused, *(action.primitive for action in self._futile)]
        try:
            return self._policy.decide(seen, self._rng, avoid=avoid)
        except NoActionError:
            if not self._futile:
                return None
        self._futile.clear()
        try:
            return self._policy.decide(seen, self._rng, avoid=refused)
        except NoActionError:
            return None


def is_seen(goal: Mask) -> bool:
    """Whether so many pixels of a heightmap show the goal that it is not hidden."""
    return int(goal.sum()) >= GOAL_PIXELS
