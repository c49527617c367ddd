from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from policies.heightmap import SIZE
from tools.train.replay import HEIGHT_STEP, TRANSITION, Replay, pack_height, unpack_height


def add(replay: Replay, reward: float) -> None:
    transition = np.zeros(1, TRANSITION)
    transition["reward"], transition["next_look"] = reward, -1
    replay.extend(
        np.full((1, SIZE, SIZE), replay.looks, np.uint16),
        np.zeros((1, SIZE, SIZE, 3), np.uint8),
        transition,
    )


@given(st.floats(-0.0625, 0.5, width=32))
def test_heights_keep_a_tenth_of_a_millimetre(height: float) -> None:
    kept = unpack_height(pack_height(np.array([height, np.nan], np.float32)))
    assert kept[0] == pytest.approx(height, abs=HEIGHT_STEP * 0.51)
    assert np.isnan(kept[1])


def test_sampling_is_proportional_to_priority(tmp_path: Path) -> None:
    replay = Replay(tmp_path, capacity=4)
    for _ in range(4):
        add(replay, 1.0)
    replay.priorities[:4] = [1, 2, 3, 4]
    rng = np.random.default_rng(0)
    picks, weights = replay.sample(40_000, rng, exponent=1.0, importance=1.0)
    share = np.bincount(picks, minlength=4) / picks.size
    np.testing.assert_allclose(share, [0.1, 0.2, 0.3, 0.4], atol=0.01)
    # (N P)^-1 relative to the largest, that of the rarest
    by_index = np.array([weights[picks == i][0] for i in range(4)])
    np.testing.assert_allclose(by_index, [1, 1 / 2, 1 / 3, 1 / 4], rtol=1e-6)


def test_a_new_transition_is_as_urgent_as_the_most_urgent(tmp_path: Path) -> None:
    replay = Replay(tmp_path, capacity=3)
    add(replay, 0.0)
    replay.reprioritize(np.array([0]), np.array([-2.0], np.float32))
    add(replay, 0.0)
    assert replay.priorities[1] == pytest.approx(2.01)


def test_a_restored_run_forgets_what_was_not_saved(tmp_path: Path) -> None:
    first = Replay(tmp_path, capacity=8)
    add(first, 0.25)
    first.reprioritize(np.array([0]), np.array([0.5], np.float32))
    saved = first.state()
    add(first, 0.75)
    first.reprioritize(np.array([0]), np.array([9.0], np.float32))
    first.heights.flush()

    again = Replay(tmp_path, capacity=8)
    again.restore(saved)
    assert (again.looks, again.size) == (1, 1)
    assert again.transitions[0]["reward"] == np.float32(0.25)
    assert again.priorities[0] == pytest.approx(0.51)
    add(again, 0.5)
    assert again.transitions[1]["look"] == 1
    assert again.heights[1, 0, 0] == 1


def test_looks_are_found_again_after_joining(tmp_path: Path) -> None:
    replay = Replay(tmp_path, capacity=8)
    add(replay, 0.0)
    transitions = np.zeros(2, TRANSITION)
    transitions["look"], transitions["next_look"] = [0, 1], [1, -1]
    replay.extend(
        np.stack([np.full((SIZE, SIZE), 7, np.uint16), np.full((SIZE, SIZE), 8, np.uint16)]),
        np.zeros((2, SIZE, SIZE, 3), np.uint8),
        transitions,
    )
    assert replay.heights[replay.transitions[1]["look"], 0, 0] == 7
    assert replay.heights[replay.transitions[1]["next_look"], 0, 0] == 8
    assert replay.transitions[2]["next_look"] == -1
