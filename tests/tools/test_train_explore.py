from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest

from policies.errors import NoActionError
from policies.heightmap import SIZE, Heightmap, Workspace
from policies.policy import ROTATIONS, Decision, QMaps
from policies.primitives import Grasp, Primitive, Push
from tools.train.config import StageKind
from tools.train.explore import Exploring

TABLE = Heightmap(
    workspace=Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15),
    color=np.zeros((SIZE, SIZE, 3), np.uint8),
    height=np.zeros((SIZE, SIZE), np.float32),
)


def values(
    *places: tuple[int, int, int], best: tuple[int, int, int] | None
) -> npt.NDArray[np.float32]:
    """-inf but for the places, of which one is the best."""
    array = np.full((ROTATIONS, SIZE, SIZE), -np.inf, np.float32)
    for place in places:
        array[place] = 0.1
    if best is not None:
        array[best] = 0.9
    return array


class Greedy:
    """Chooses one grasp, whatever the values."""

    def __init__(self, *, push: bool = True) -> None:
        self.maps = QMaps(
            grasp=values((1, 10, 20), (2, 30, 40), best=(3, 50, 60)),
            push=values((4, 70, 80), best=(5, 90, 100)) if push else values(best=None),
        )

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        return Decision(
            primitive=Grasp(x=0.5, y=0.0, z=-0.1, yaw=0.0),
            rotation=1,
            row=10,
            col=20,
            q=0.1,
            maps=self.maps,
            verdict=None,
            seconds={},
        )


def decide(
    stage: StageKind, epsilon: float, *, pushed: bool = False, policy: Greedy | None = None
) -> list[Decision]:
    player = Exploring(policy or Greedy(), stage, epsilon, prepared=lambda: pushed)
    rng = np.random.default_rng(0)
    return [player.decide(TABLE, rng) for _ in range(200)]


def place(decision: Decision) -> tuple[int, int, int]:
    return decision.rotation, decision.row, decision.col


def test_without_exploration_synergy_is_the_policy_itself() -> None:
    assert {place(decision) for decision in decide("synergy", 0.0)} == {(1, 10, 20)}


@pytest.mark.parametrize("pushed", [False, True])
def test_the_push_stage_pushes_and_grasps_in_turn(pushed: bool) -> None:
    """Paper, section III-C: stage II fixes the action; step II is the best grasp."""
    decisions = decide("push", 0.0, pushed=pushed)
    assert {place(decision) for decision in decisions} == {(3, 50, 60) if pushed else (5, 90, 100)}
    assert isinstance(decisions[0].primitive, Grasp if pushed else Push)


def test_all_allowed_actions_of_both_kinds_are_explored() -> None:
    decisions = decide("synergy", 1.0)
    assert {place(decision) for decision in decisions} == {
        (1, 10, 20),
        (2, 30, 40),
        (3, 50, 60),
        (4, 70, 80),
        (5, 90, 100),
    }
    pushes = sum(isinstance(decision.primitive, Push) for decision in decisions)
    assert 70 < pushes < 130  # of 200; half are expected, with a deviation of 7
    row, col = decisions[0].row, decisions[0].col
    x, y = TABLE.workspace.to_base(row, col)
    assert (decisions[0].primitive.x, decisions[0].primitive.y) == pytest.approx((x, y))


def test_what_is_explored_is_as_often_as_epsilon_says() -> None:
    others = [place(d) != (3, 50, 60) for d in decide("grasp", 0.3, policy=Greedy(push=False))]
    assert 0.1 < np.mean(others) < 0.3  # 0.2 is expected, with a deviation of 0.03


def test_a_validation_is_not_explored() -> None:
    assert {place(decision) for decision in decide("push", 1.0, pushed=True)} == {(3, 50, 60)}
    assert {place(decision) for decision in decide("synergy", 1.0, pushed=True)} == {(1, 10, 20)}


def test_a_stage_without_allowed_actions_ends_the_trial() -> None:
    for epsilon in (0.0, 1.0):
        with pytest.raises(NoActionError, match="no push is allowed"):
            decide("push", epsilon, policy=Greedy(push=False))
