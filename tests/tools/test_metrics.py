from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tdpg_deploy.outcome import EndReason
from tools.evaluate.metrics import EpisodeRow, evaluate


def row(
    reason: EndReason = EndReason.CLEARED,
    objects: int = 10,
    actions: int = 10,
    grasps: int = 10,
    successes: int = 10,
    goal: bool = False,
) -> EpisodeRow:
    return EpisodeRow(
        scene="random 10", seed=0, reason=reason, objects=objects, actions=actions,
        grasps=grasps, grasp_successes=successes, goal=goal,
    )  # fmt: skip


def test_by_hand() -> None:
    metrics = evaluate(
        [
            row(actions=20, grasps=16, successes=10),
            row(actions=12, grasps=10, successes=10),
            row(EndReason.STUCK, actions=30, grasps=30, successes=3),
        ]
    )
    assert metrics.completion.value == pytest.approx(2 / 3)
    assert metrics.of_completed.episodes == 2
    assert metrics.of_completed.grasp_success.value == pytest.approx((10 / 16 + 1) / 2)
    assert metrics.of_completed.action_efficiency.value == pytest.approx((10 / 20 + 10 / 12) / 2)
    assert metrics.of_completed.motions.value == pytest.approx(16)
    assert metrics.of_all.grasp_success.value == pytest.approx((10 / 16 + 1 + 0.1) / 3)
    assert metrics.of_all.motions.value == pytest.approx(62 / 3)
    assert metrics.of_all.action_efficiency.value == pytest.approx((10 / 20 + 10 / 12 + 3 / 30) / 3)
    assert metrics.reasons == {EndReason.CLEARED: 2, EndReason.STUCK: 1}


def test_wilsons_interval_by_its_formula() -> None:
    k, n, z = 27, 30, 1.959963985
    metrics = evaluate([row()] * k + [row(EndReason.STUCK)] * (n - k))
    p = k / n
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert metrics.completion.low == pytest.approx(middle - half, abs=1e-9)
    assert metrics.completion.high == pytest.approx(middle + half, abs=1e-9)


def test_no_completed_episode_is_not_a_number_rather_than_zero() -> None:
    metrics = evaluate([row(EndReason.STUCK, actions=10, grasps=10, successes=0)])
    assert metrics.completion.value == 0
    assert np.isnan(metrics.of_completed.grasp_success.value)
    assert metrics.of_all.grasp_success.value == 0


def test_a_goal_that_was_not_fetched_is_no_object_cleared() -> None:
    fetched = row(EndReason.GOAL_REACHED, objects=1, actions=2, grasps=2, successes=2, goal=True)
    lost = row(EndReason.STUCK, objects=1, actions=10, grasps=10, successes=3, goal=True)
    metrics = evaluate([fetched, lost])
    assert metrics.of_completed.action_efficiency.value == pytest.approx(0.5)
    assert metrics.of_all.action_efficiency.value == pytest.approx(0.25)
    assert metrics.of_all.grasp_success.value == pytest.approx((1 + 0.3) / 2)


def test_two_objects_in_one_grasp_are_more_than_one_object_an_action() -> None:
    metrics = evaluate([row(objects=10, actions=9, grasps=9, successes=9)])
    assert metrics.of_all.action_efficiency.value == pytest.approx(10 / 9)


def test_no_episode_is_an_error() -> None:
    with pytest.raises(ValueError, match="no episodes"):
        evaluate([])


@given(st.lists(st.integers(1, 40), min_size=2, max_size=20))
def test_the_interval_holds_the_mean(actions: list[int]) -> None:
    motions = evaluate([row(actions=n) for n in actions]).of_all.motions
    assert motions.low <= motions.value <= motions.high
