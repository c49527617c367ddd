"""Rewards by the paper's equations, from scripted trials."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from policies.heightmap import SIZE, Heightmap, Workspace
from policies.policy import ROTATIONS, Decision, QMaps
from policies.primitives import Grasp, Push
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.hal import RgbdFrame
from tdpg_deploy.outcome import EndReason, GraspOutcome, Motion, Outcome, PushOutcome, Verdict
from tdpg_deploy.plan import Plan
from tools.train.config import PushReward
from tools.train.notebook import Notebook
from tools.train.replay import unpack_goal

YES, NO, UNKNOWN = Verdict.YES, Verdict.NO, Verdict.UNKNOWN
WORKSPACE = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)
MOTION = Motion(contact=None, seconds=1.0)


def heightmap(*, goal: bool | None = None) -> Heightmap:
    """goal: whether there is a goal to be seen; None: nothing is to be fetched."""
    mask = None if goal is None else np.zeros((SIZE, SIZE), np.bool_)
    if mask is not None and goal:
        mask[100:120, 100:120] = True
    return Heightmap(
        workspace=WORKSPACE,
        color=np.zeros((SIZE, SIZE, 3), np.uint8),
        height=np.zeros((SIZE, SIZE), np.float32),
        goal=mask,
    )


def maps(best_grasp: float, at: int = 50) -> QMaps:
    """at: the row of the best grasp; the goal lies in rows and columns 100 to 119."""
    grasp = np.full((ROTATIONS, SIZE, SIZE), -np.inf, np.float32)
    grasp[:, at, at + 10 if at < 100 else at] = best_grasp
    return QMaps(push=np.zeros_like(grasp), grasp=grasp)


def decision(kind: str, best_grasp: float, at: int = 50, *, beside: bool = False) -> Decision:
    """In the middle of the goal, or beside it."""
    place = 60 if beside else 110
    x, y = (float(value) for value in WORKSPACE.to_base(place, place))
    make = Push if kind == "push" else Grasp
    return Decision(
        primitive=make(x=x, y=y, z=-0.1, yaw=0.0),
        rotation=0,
        row=place,
        col=place,
        q=0.0,
        maps=maps(best_grasp, at),
        verdict=None,
        seconds={},
    )


def outcome(kind: str, success: Verdict, *, gone: Verdict | None = None) -> Outcome:
    """gone: what the map says of a grasp, when it disagrees with the pads."""
    if kind == "push":
        return PushOutcome(motion=MOTION, travelled=0.1, changed=success)
    nan = math.nan
    return GraspOutcome(
        motion=MOTION,
        width_after_close=nan,
        width_after_lift=nan,
        held_by_width=success,
        gone_from_map=gone or success,
    )


class Trial:
    """Tells a notebook of a trial, in the order in which an episode does."""

    def __init__(self, reward: PushReward | None = None, *, goal: bool | None = None) -> None:
        self.note = Notebook(reward or PushReward(), np.random.default_rng(0))
        self._look(goal)

    def act(
        self,
        kind: str,
        success: Verdict,
        *,
        best_grasp: float = 0.0,
        best_at: int = 50,
        goal: bool | None = None,
        gone: Verdict | None = None,
        beside: bool = False,
    ) -> Trial:
        """best_grasp, best_at: its value before the action, and its row; goal: what is seen of
        it afterwards; gone: as in `outcome`; beside: the goal."""
        chosen = decision(kind, best_grasp, best_at, beside=beside)
        self.note.intend(chosen, Plan(primitive=chosen.primitive, approach=()), stamp=0.0)
        self._look(goal)
        self.note.conclude(outcome(kind, success, gone=gone), stamp=1.0)
        return self

    def end(self, reason: EndReason = EndReason.CLEARED) -> npt.NDArray[np.void]:
        result = EpisodeResult(
            reason=reason,
            actions=0,
            grasps=0,
            pushes=0,
            grasp_successes=0,
            push_successes=0,
            delivered=0,
            refused=0,
            seconds=0.0,
        )
        self.note.end(result, stamp=2.0)
        return self.note.experience().transitions

    def _look(self, goal: bool | None) -> None:
        frame: RgbdFrame = None  # type: ignore[assignment]  # not looked at
        self.note.observe(frame, heightmap(goal=goal))


def test_a_grasp_is_worth_one_or_nothing() -> None:
    """Paper, section III-A; the same is Critic II's label."""
    transitions = Trial().act("grasp", YES).act("grasp", NO).end()
    np.testing.assert_array_equal(transitions["reward"], [1, 0])
    np.testing.assert_array_equal(transitions["grasped"], [1, 0])


@pytest.mark.parametrize(
    ("after", "grasped", "reward"),
    [(0.6, YES, 1.0), (0.6, NO, 0.5), (0.5, YES, 0.5), (0.5, NO, 0.0), (0.4, YES, 0.5)],
)
def test_a_push_is_rewarded_for_a_better_grasp_and_for_one_that_succeeds(
    after: float, grasped: Verdict, reward: float
) -> None:
    """Paper, eq. 3 and 4; the best grasp was worth 0.5 before the push."""
    trial = Trial().act("push", YES, best_grasp=0.5).act("grasp", grasped, best_grasp=after)
    transitions = trial.end()
    (push,) = transitions[transitions["push"]]
    assert push["reward"] == pytest.approx(reward)
    assert push["grasped"] == -1  # Critic II learns of grasps only
    assert push["next_look"] == 1
    (grasp,) = transitions[~transitions["push"]]
    assert grasp["reward"] == (grasped is YES)  # the validation grasp teaches GraspNet


def test_each_part_of_the_reward_can_be_switched_off() -> None:
    def worth(reward: PushReward) -> float:
        trial = Trial(reward).act("push", YES, best_grasp=0.1).act("grasp", YES, best_grasp=0.2)
        transitions = trial.end()
        return float(transitions["reward"][transitions["push"]].item())

    assert worth(PushReward(rose=0.5, validated=0)) == 0.5
    assert worth(PushReward(rose=0, validated=0.25)) == 0.25
    assert worth(PushReward(rose=0, validated=0, changed=0.125)) == 0.125


@pytest.mark.parametrize(
    ("rise", "moved", "reward"), [(0.2, YES, 1.0), (0.05, YES, 0.5), (0.2, NO, 0)]
)
def test_a_rise_by_noise_and_an_idle_push_need_not_count(
    rise: float, moved: Verdict, reward: float
) -> None:
    trial = Trial(PushReward(least_rise=0.1, idle=0.0)).act("push", moved, best_grasp=0.1)
    transitions = trial.act("grasp", YES, best_grasp=0.1 + rise).end()
    assert transitions["reward"][transitions["push"]].item() == pytest.approx(reward)


def test_what_was_knocked_over_was_not_grasped() -> None:
    trial = Trial()
    trial.act("grasp", NO, gone=YES).act("grasp", YES, gone=NO)
    (grasp,) = trial.end()  # the second disagreement teaches nothing
    assert grasp["reward"] == grasp["grasped"] == 0


def test_a_push_that_another_push_follows_is_not_validated() -> None:
    trial = Trial().act("push", YES, best_grasp=0.1).act("push", YES, best_grasp=0.2)
    transitions = trial.act("grasp", YES, best_grasp=0.1).end()
    pushes = transitions[transitions["push"]]
    np.testing.assert_array_equal(pushes["reward"], [0.5, 0.5])  # by eq. 3, by eq. 4


def test_a_push_before_a_grasp_of_unknown_outcome_teaches_nothing() -> None:
    assert len(Trial().act("push", YES).act("grasp", UNKNOWN).end()) == 0


def test_a_push_that_ends_a_trial_leads_nowhere() -> None:
    (push,) = Trial().act("push", YES, best_grasp=0.1).end()
    assert (push["reward"], push["next_look"]) == (0, -1)


def test_when_only_the_round_ends_the_next_look_still_counts() -> None:
    trial = Trial().act("grasp", NO)
    trial.end(EndReason.ACTION_LIMIT)
    trial.note.cut_short(maps(0.7))
    (grasp,) = trial.note.experience().transitions
    assert grasp["next_look"] == 1
    assert grasp["next_grasps"][0].tolist() in [[k, 50, 60] for k in range(ROTATIONS // 2)]

    unfinished = Trial().act("push", YES)
    unfinished.end(EndReason.ACTION_LIMIT)
    unfinished.note.cut_short(maps(0.7))
    assert len(unfinished.note.experience().transitions) == 0  # no grasp has validated it


def test_looks_without_an_action_are_left_out() -> None:
    trial = Trial().act("grasp", UNKNOWN).act("grasp", YES).act("grasp", YES)
    transitions = trial.end()
    experience = trial.note.experience()
    assert len(experience.heights) == len(experience.colors) == 2
    np.testing.assert_array_equal(transitions["look"], [0, 1])
    np.testing.assert_array_equal(transitions["next_look"], [1, -1])


def test_bringing_something_else_than_the_goal_earns_nothing() -> None:
    trial = Trial(goal=True).act("grasp", YES, goal=True).act("grasp", YES, goal=False)
    transitions = trial.end(EndReason.GOAL_REACHED)
    np.testing.assert_array_equal(transitions["reward"], [0, 1])
    np.testing.assert_array_equal(transitions["grasped"], [1, 1])  # what Critic II is asked
    goals = trial.note.experience().goals
    assert goals is not None
    assert unpack_goal(goals[0]).sum() == 400


@pytest.mark.parametrize(("at", "reward", "following"), [(110, 0.5, 1), (50, 0.0, -1)])
def test_with_a_goal_only_grasps_on_it_make_a_state_better(
    at: int, reward: float, following: int
) -> None:
    """A grasp beside the goal was worth 0.4; after the push one of 0.9 is allowed at `at`."""
    trial = Trial(PushReward(validated=0.0), goal=True)
    trial.act("push", YES, best_grasp=0.4, goal=True)
    trial.act("grasp", YES, best_grasp=0.9, best_at=at, goal=True)
    transitions = trial.end()
    (push,) = transitions[transitions["push"]]
    assert (push["reward"], push["next_look"]) == (pytest.approx(reward), following)


@pytest.mark.parametrize(
    ("success", "fetched", "reward"),
    [(YES, YES, 1.0), (YES, NO, 0.5), (NO, YES, 0.0), (UNKNOWN, YES, 1.0)],
)
def test_a_grasp_that_clears_the_way_is_worth_what_follows_it(
    success: Verdict, fetched: Verdict, reward: float
) -> None:
    """The goal's best grasp rises from 0.4 to 0.9; what moved nothing has no part in that."""
    trial = Trial(PushReward(idle=0.0), goal=True)
    trial.act("grasp", success, best_grasp=0.4, best_at=110, goal=True, beside=True)
    assert trial.note.prepared
    trial.act("grasp", fetched, best_grasp=0.9, best_at=110, goal=fetched is NO)
    clearing, fetching = trial.end()
    assert clearing["reward"] == pytest.approx(reward)
    assert clearing["grasped"] == {YES: 1, NO: 0, UNKNOWN: -1}[success]
    assert (fetching["reward"], fetching["grasped"]) == (fetched is YES, fetched is YES)


def test_only_what_follows_a_push_validates_it() -> None:
    trial = Trial()
    assert not trial.note.prepared
    assert trial.act("push", YES).note.prepared
    assert not trial.act("grasp", YES).note.prepared
    trial.act("push", YES).end()
    assert not trial.note.prepared  # another trial
