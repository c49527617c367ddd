from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from seen import CONFIG

from policies.decide import Choice, decided
from policies.heightmap import SIZE, Heightmap
from policies.learned import LearnedPolicy
from policies.methods import METHODS
from policies.networks.light import LightNet
from policies.policy import ROTATIONS, Decision, QMaps
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy.foresight.policy import BY_VALUE, PLENTY, ForeseeingPolicy, with_foresight
from tdpg_deploy.workspace import workspace_of


def table(*, goal: bool = True) -> Heightmap:
    mask = np.zeros((SIZE, SIZE), np.bool_)
    mask[100:120, 100:120] = True
    return Heightmap(
        workspace=workspace_of(CONFIG),
        color=np.zeros((SIZE, SIZE, 3), np.uint8),
        height=np.zeros((SIZE, SIZE), np.float32),
        goal=mask if goal else None,
    )


class Chooses:
    """One kind of action, always. Pushes upwards are allowed in a row; the further to the right,
    the more they are worth."""

    def __init__(self, kind: str = "push") -> None:
        self.kind = kind
        self.avoided: Sequence[Primitive] = ()

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        self.avoided = avoid
        push = np.full((ROTATIONS, SIZE, SIZE), -np.inf, np.float32)
        push[0, 150, 20:200] = np.arange(180) / 180
        maps = QMaps(push=push, grasp=np.full_like(push, -np.inf))
        choice = Choice(kind="push", rotation=0, row=150, col=199, q=float(push[0, 150, 199]))
        if self.kind == "grasp":
            choice = Choice(kind="grasp", rotation=0, row=110, col=110, q=1.0)
        return decided(choice, heightmap, maps, seconds={"critic_one": 0.1})


class Foresees:
    """By the pushes' y in base, and what it was asked."""

    def __init__(self, *grasps: int) -> None:
        self.grasps = grasps
        self.asked: list[Push] = []

    def __call__(self, heightmap: Heightmap, pushes: Sequence[Push]) -> Iterator[int]:
        for push, grasps in zip(pushes, self.grasps, strict=False):
            self.asked.append(push)
            yield grasps


def decide(foresees: Foresees, policy: Chooses | None = None, *, pushes: int = 8) -> Decision:
    foreseeing = ForeseeingPolicy(policy or Chooses(), foresees, pushes=pushes)
    return foreseeing.decide(table(), np.random.default_rng(0))


def test_the_push_that_frees_most_is_made() -> None:
    foresees = Foresees(0, 20, 90, 40, 0, 0, 0, 0)
    decision = decide(foresees)
    assert decision.primitive == foresees.asked[2]
    assert decision.foreseen == 90
    assert decision.q == pytest.approx(float(decision.maps.push[0, decision.row, decision.col]))
    assert {"critic_one", "foresight"} == set(decision.seconds)


def test_the_first_that_frees_plenty_is_enough() -> None:
    foresees = Foresees(0, PLENTY, 2 * PLENTY)
    decision = decide(foresees)
    assert len(foresees.asked) == 2
    assert decision.primitive == foresees.asked[1]


@pytest.mark.parametrize("grasps", [(), (0,) * 8], ids=["goal not seen", "none frees it"])
def test_where_nothing_is_foreseen_the_policy_s_own_push_is_made(grasps: tuple[int, ...]) -> None:
    decision = decide(Foresees(*grasps))
    assert (decision.rotation, decision.row, decision.col) == (0, 150, 199)
    assert decision.foreseen == 0


def test_the_most_valued_are_tried_first_then_others_none_near_another() -> None:
    foresees = Foresees(*[0] * 30)
    decide(foresees, pushes=30)
    at = np.array([push.y for push in foresees.asked])  # base +y is to the left
    assert len(at) > BY_VALUE
    first = at[:BY_VALUE]
    assert (np.diff(first) > 0).all()
    assert first[0] == at.min()
    assert np.diff(np.sort(at)).min() > 0.0099


def test_no_more_are_tried_than_asked_for() -> None:
    foresees = Foresees(*[0] * 30)
    decide(foresees, pushes=3)
    assert len(foresees.asked) == 3


def test_a_grasp_is_made_unasked() -> None:
    foresees = Foresees(PLENTY)
    decision = decide(foresees, Chooses("grasp"))
    assert isinstance(decision.primitive, Grasp)
    assert decision.foreseen is None
    assert not foresees.asked


def test_so_is_a_push_without_a_goal() -> None:
    foresees = Foresees(PLENTY)
    policy = ForeseeingPolicy(Chooses(), foresees, pushes=8)
    decision = policy.decide(table(goal=False), np.random.default_rng(0))
    assert decision.foreseen is None
    assert not foresees.asked


def test_what_is_to_be_avoided_is_told_on() -> None:
    policy, avoid = Chooses(), [Push(x=0.5, y=0.0, z=0.0, yaw=0.0)]
    foreseeing = ForeseeingPolicy(policy, Foresees(), pushes=8)
    foreseeing.decide(table(), np.random.default_rng(0), avoid=avoid)
    assert policy.avoided == avoid


def test_only_a_method_with_foresight_has_it() -> None:
    network = LightNet(goal=True)
    plain, foreseeing = (
        LearnedPolicy(network, dataclasses.replace(METHODS["tdpg"], foreseen=foreseen), goal=True)
        for foreseen in (0, 4)
    )
    assert with_foresight(plain, CONFIG) is plain
    assert isinstance(with_foresight(foreseeing, CONFIG), ForeseeingPolicy)
    assert METHODS["tdpg-foreseen"].foreseen
