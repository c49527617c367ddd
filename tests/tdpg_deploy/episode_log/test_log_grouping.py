"""A step is bounded, and what was read of it is not lost."""

from __future__ import annotations

from itertools import chain, repeat

import pytest
from synthetic_episode import Synthetic

from tdpg_deploy.episode_log import grouping
from tdpg_deploy.episode_log.entries import Entry, Intent, LoggedDecision, Step, ToolPoint
from tdpg_deploy.errors import LogError


def test_a_step_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grouping, "MAX_ENTRIES", 100)
    synthetic = Synthetic()
    decision = synthetic.decision(synthetic.blocks(1), push=False)
    intent: Entry = Intent(
        decision=LoggedDecision.of(decision), plan=synthetic.plan(decision.primitive), stamp=1.0
    )
    point = ToolPoint(p_base=(0.5, 0.0, 0.1), force=3.0, stamp=2.0)
    steps: list[Step] = []
    with pytest.raises(LogError, match="more than 100 states"):
        steps.extend(grouping.group(chain([intent], repeat(point))))
    [step] = steps
    assert len(step.tool_path) == 100
