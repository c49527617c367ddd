from __future__ import annotations

from importlib.resources import files

import pytest

from policies.errors import CheckpointError
from policies.learned import LearnedPolicy
from policies.shipped import CLEAR, FETCH, open_policy


@pytest.mark.parametrize(("goal", "name"), [(False, CLEAR), (True, FETCH)])
def test_the_shipped_policy_reads_a_goal_where_one_is_to_be_fetched(goal: bool, name: str) -> None:
    policy = open_policy(goal=goal)
    assert policy.name == name
    assert isinstance(policy.decider, LearnedPolicy)
    assert policy.decider.goal is goal


@pytest.mark.parametrize("name", [CLEAR, FETCH, "paper.safetensors"])
def test_what_is_shipped_is_small_and_has_its_card(name: str) -> None:
    weights = files("policies") / "weights"
    sha256 = open_policy(str(weights / name)).sha256
    assert sha256 is not None
    assert len((weights / name).read_bytes()) < 15e6
    assert sha256 in (weights / name.replace(".safetensors", ".md")).read_text(encoding="utf-8")


def test_a_name_counts_with_a_goal_too() -> None:
    assert open_policy("random", goal=True).sha256 is None
    with pytest.raises(CheckpointError):
        open_policy("nowhere.safetensors", goal=True)
