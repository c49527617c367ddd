"""A stored log of every schema version stays readable. Never write these files anew."""

from __future__ import annotations

from pathlib import Path

import pytest

from policies.primitives import Push
from tdpg_deploy.episode_log.about import SCHEMA_VERSION
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.episode_log.recover import Condition, check
from tdpg_deploy.outcome import EndReason, GraspOutcome, PushOutcome, Verdict

STORED = Path(__file__).parent / "data"


@pytest.mark.parametrize("version", range(1, SCHEMA_VERSION + 1))
def test_every_version_has_a_stored_log_that_is_whole(version: int) -> None:
    assert check(STORED / f"schema_{version}.mcap").condition is Condition.WHOLE


def test_schema_1() -> None:
    episode = read_episode(STORED / "schema_1.mcap")
    assert episode.about.cell.name == "mock"
    assert episode.about.seed == 7
    first, second = episode.steps()
    assert first.look is not None
    assert first.look.frame.color.shape == (12, 16, 3)
    heightmap = first.look.heightmap
    assert heightmap.goal is not None
    assert heightmap.goal.sum() == 1680  # three blocks of 20 x 28 pixels
    assert not heightmap.valid[:20, :20].any()
    assert isinstance(first.outcome, GraspOutcome)
    assert first.outcome.gone_from_map is Verdict.YES
    assert second.intent is not None
    assert second.intent.decision.primitive == Push(
        x=0.619, y=0.117, z=-0.12, yaw=3.9269908169872414, length=0.1
    )
    assert len(second.refusals) == 1
    assert second.gripper_states[0].width == pytest.approx(0.006155, abs=1e-6)
    assert isinstance(second.outcome, PushOutcome)
    assert second.outcome.travelled == 0.083
    result = episode.result()
    assert result is not None
    assert result.reason is EndReason.ACTION_LIMIT
    assert result.truth == {"on_table": 3, "lost": 0}
