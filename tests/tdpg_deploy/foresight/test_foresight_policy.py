from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from seen import CONFIG

from policies.decide import decided
from policies.heightmap import SIZE, Heightmap
from policies.learned import LearnedPolicy
from policies.methods import METHODS
from policies.networks.light import LightNet
from policies.policy import ROTATIONS, Choice, CriticVerdict, Decision, QMaps
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy.foresight.imagined import WORLDS
from tdpg_deploy.foresight.policy import (
    BY_VALUE,
    DOUBTFUL,
    ENOUGH,
    FREE,
    SOME,
    TRUSTED,
    UNLIKELY,
    ForeseeingPolicy,
    with_foresight,
)
from tdpg_deploy.workspace import workspace_of

PLENTY = 100 * FREE  # sure grasps


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
    """Pushes, unless it is to grasp. Pushes upwards are allowed in a row; the further to the right,
    the more they are worth. Critic II gives grasps at (110, 101), (110, 102) ..., which are the
    goal's, and then one that is not, what it is told."""

    def __init__(self, *p_success: float, beside: float = 0.0, grasps: int | None = None) -> None:
        """grasps: which of the grasps it would make."""
        cols = [101 + index for index in range(len(p_success))] + [50]
        self.grasps = tuple(
            Choice(kind="grasp", rotation=0, row=110, col=col, q=1 - col / 1000) for col in cols
        )
        self.verdict = CriticVerdict(p_success=(*p_success, beside), overruled=False)
        self.chosen = None if grasps is None else self.grasps[grasps]
        self.avoided: Sequence[Primitive] = ()

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        self.avoided = avoid
        push = np.full((ROTATIONS, SIZE, SIZE), -np.inf, np.float32)
        push[0, 150, 20:200] = np.arange(180) / 180
        maps = QMaps(push=push, grasp=np.full_like(push, -np.inf))
        best = Choice(kind="push", rotation=0, row=150, col=199, q=float(push[0, 150, 199]))
        return decided(
            self.chosen or best,
            heightmap,
            maps,
            verdict=self.verdict,
            considered=self.grasps,
            seconds={"critic_one": 0.1},
        )


class Foresees:
    """What it is told of each push and grasp, in the order in which it is asked for them."""

    def __init__(
        self, *pushes: Sequence[int], grasps: Sequence[bool] = (), everywhere: bool = True
    ) -> None:
        self.pushes = iter(pushes)
        self.holds_everywhere = everywhere
        self.grasps = iter(grasps)
        self.asked: list[Push] = []
        self.asked_of: list[Grasp] = []
        self.worlds = 0

    def takes_goal(self, grasp: Grasp) -> Iterator[bool]:
        """In the first world as it is told; in later ones if it is told that it holds there."""
        self.asked_of.append(grasp)
        yield next(self.grasps, False)
        while True:
            self.worlds += 1
            yield self.holds_everywhere

    def grasps_after(self, push: Push) -> Iterator[int]:
        self.asked.append(push)
        for count in next(self.pushes, [0] * WORLDS):
            self.worlds += 1
            yield count


def decide(
    foresees: Foresees | None, policy: Chooses | None = None, *, pushes: int = 8
) -> Decision:
    foreseeing = ForeseeingPolicy(policy or Chooses(), lambda _: foresees, pushes=pushes)
    return foreseeing.decide(table(), np.random.default_rng(0))


def everywhere(count: int) -> list[int]:
    return [count] * WORLDS


# --- pushes -----------------------------------------------------------------------------------


def test_the_push_that_frees_in_most_worlds_is_made() -> None:
    rarely, mostly = ([PLENTY] * (WORLDS - bad) + [0] * bad for bad in (3, 1))
    foresees = Foresees(everywhere(0), rarely, mostly, rarely)
    decision = decide(foresees)
    assert decision.primitive == foresees.asked[2]
    assert decision.p_foreseen == pytest.approx(1 - 1 / WORLDS)
    assert decision.q == pytest.approx(float(decision.maps.push[0, decision.row, decision.col]))
    assert {"critic_one", "foresight"} == set(decision.seconds)


def test_of_those_that_free_it_everywhere_the_one_with_most_grasps_is_made() -> None:
    foresees = Foresees(everywhere(20), everywhere(FREE), everywhere(40))
    decision = decide(foresees)
    assert decision.primitive == foresees.asked[1]
    assert decision.p_foreseen == pytest.approx(1 - 1 / np.e)


def test_the_first_that_frees_plenty_in_all_is_enough() -> None:
    foresees = Foresees(everywhere(0), everywhere(PLENTY), everywhere(2 * PLENTY))
    decision = decide(foresees)
    assert len(foresees.asked) == 2
    assert decision.primitive == foresees.asked[1]
    assert (decision.p_foreseen or 0) >= ENOUGH


def test_only_what_may_be_the_best_is_tried_in_other_worlds() -> None:
    """One that leaves few in the first; then one that frees in all but two; then one that frees in
    the first, and not in the next two."""
    late = [*[PLENTY] * (WORLDS - 2), 0, 0]
    early = [PLENTY, 0, 0, *[PLENTY] * (WORLDS - 3)]
    foresees = Foresees([SOME - 1, *everywhere(PLENTY)], late, early)
    decide(foresees, pushes=3)
    assert foresees.worlds == 1 + WORLDS + 3


def test_where_none_frees_it_the_one_that_leaves_some_grasps_is_made() -> None:
    foresees = Foresees(everywhere(0), everywhere(SOME - 1), everywhere(1))
    decision = decide(foresees)
    assert decision.primitive == foresees.asked[1]
    assert 0 < (decision.p_foreseen or 0) < 0.1


@pytest.mark.parametrize("foresees", [None, Foresees()], ids=["goal not seen", "none frees it"])
def test_where_nothing_is_foreseen_the_policy_s_own_push_is_made(foresees: Foresees | None) -> None:
    decision = decide(foresees)
    assert (decision.rotation, decision.row, decision.col) == (0, 150, 199)
    assert decision.p_foreseen == (None if foresees is None else 0.0)


def test_the_most_valued_are_tried_first_then_others_none_near_another() -> None:
    foresees = Foresees()
    decide(foresees, pushes=30)
    at = np.array([push.y for push in foresees.asked])  # base +y is to the left
    assert len(at) > BY_VALUE
    first = at[:BY_VALUE]
    assert (np.diff(first) > 0).all()
    assert first[0] == at.min()
    assert np.diff(np.sort(at)).min() > 0.0099


def test_no_more_are_tried_than_asked_for() -> None:
    foresees = Foresees()
    decide(foresees, pushes=3)
    assert len(foresees.asked) == 3


# --- grasps -----------------------------------------------------------------------------------


def col_of(decision: Decision) -> int:
    assert isinstance(decision.primitive, Grasp)
    return decision.col


def test_of_grasps_that_can_be_trusted_the_nearest_to_the_middle_is_tried_first() -> None:
    """The goal's middle is at column 109.5."""
    foresees = Foresees(grasps=[False, True])
    decision = decide(foresees, Chooses(0.98, 0.999, TRUSTED, 0.99, 0.97, grasps=0))
    assert [round(grasp.y, 3) for grasp in foresees.asked_of] == [y_of(104), y_of(103)]
    assert col_of(decision) == 103
    assert decision.p_foreseen == 1.0
    assert not foresees.asked


def test_then_the_others_the_surest_first() -> None:
    foresees = Foresees(grasps=[False, False, True])
    decision = decide(foresees, Chooses(0.97, 0.99, 0.98, grasps=0))
    assert [round(grasp.y, 3) for grasp in foresees.asked_of] == [y_of(102), y_of(103), y_of(101)]
    assert col_of(decision) == 101


def y_of(col: int) -> float:
    return round(float(table().workspace.to_base(110, col)[1]), 3)


def test_so_is_one_that_critic_two_doubts() -> None:
    decision = decide(Foresees(grasps=[True]), Chooses(DOUBTFUL))
    assert col_of(decision) == 101
    assert decision.p_foreseen == 1.0


@pytest.mark.parametrize("holds", [True, False])
def test_one_that_it_gives_less_is_made_if_it_takes_the_goal_in_all_worlds(holds: bool) -> None:
    foresees = Foresees(everywhere(PLENTY), grasps=[True], everywhere=holds)
    decision = decide(foresees, Chooses(DOUBTFUL - 0.01))
    assert isinstance(decision.primitive, Grasp) == holds


def test_where_it_gives_enough_one_world_is_asked() -> None:
    foresees = Foresees(grasps=[True], everywhere=False)
    assert isinstance(decide(foresees, Chooses(DOUBTFUL)).primitive, Grasp)
    assert foresees.worlds == 0


def test_but_not_one_that_it_gives_little() -> None:
    foresees = Foresees(everywhere(PLENTY), grasps=[True])
    assert isinstance(decide(foresees, Chooses(UNLIKELY - 0.01)).primitive, Push)
    assert not foresees.asked_of


def test_the_most_promising_is_made_anyway_where_critic_two_can_be_trusted() -> None:
    decision = decide(Foresees(everywhere(PLENTY)), Chooses(0.97, TRUSTED, grasps=0))
    assert col_of(decision) == 102
    assert decision.p_foreseen == 0.0


def test_where_it_cannot_a_push_frees_the_goal_first() -> None:
    foresees = Foresees(everywhere(PLENTY))
    decision = decide(foresees, Chooses(0.97, grasps=0))
    assert decision.primitive == foresees.asked[0]


def test_and_without_a_push_that_does_the_policy_has_its_way() -> None:
    decision = decide(Foresees(), Chooses(0.97, grasps=0))
    assert col_of(decision) == 101
    assert decision.p_foreseen == 0.0


def test_what_is_in_the_way_is_lifted_unasked() -> None:
    foresees = Foresees(everywhere(PLENTY))
    decision = decide(foresees, Chooses(0.2, beside=0.99, grasps=1))
    assert col_of(decision) == 50
    assert decision.p_foreseen is None
    assert not foresees.asked


# --- when -------------------------------------------------------------------------------------


def test_without_a_goal_nothing_is_tried() -> None:
    foresees = Foresees(everywhere(PLENTY))
    policy = ForeseeingPolicy(Chooses(), lambda _: foresees, pushes=8)
    decision = policy.decide(table(goal=False), np.random.default_rng(0))
    assert decision.p_foreseen is None
    assert not foresees.asked


def test_what_is_to_be_avoided_is_told_on() -> None:
    policy, avoid = Chooses(), [Push(x=0.5, y=0.0, z=0.0, yaw=0.0)]
    foreseeing = ForeseeingPolicy(policy, lambda _: None, pushes=8)
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
