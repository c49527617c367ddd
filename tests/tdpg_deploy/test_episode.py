"""The loop on a cell without physics: how episodes end, and what is told to the log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from kinematic_cell import (
    CAMERA_HEIGHT,
    Box,
    FakeArm,
    FakeCamera,
    Table,
    kinematic_cell,
    kinematic_config,
)

from policies.errors import NoActionError
from policies.heightmap import SIZE, Heightmap
from policies.policy import ROTATIONS, Decision, QMaps
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy.cell import Cell, GoalPixels
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.choosing import MAX_REFUSALS
from tdpg_deploy.episode import MAX_SEARCHES, run_episode, took_goal, witnessed
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import CameraError, ConfigError, LogError, ProtectiveStop
from tdpg_deploy.hal import ArmState, GripperState, RgbdFrame
from tdpg_deploy.outcome import EndReason, GraspOutcome, Motion, Outcome, Verdict
from tdpg_deploy.plan import Plan
from tdpg_deploy.workspace import workspace_of

CONFIG = kinematic_config()
TABLE_Z = CONFIG.workspace.table_z
EMPTY = np.full((ROTATIONS, SIZE, SIZE), -np.inf, np.float32)

Rule = Callable[[Heightmap, Sequence[Primitive]], Primitive | None]


class Scripted:
    """A policy by rule; None from the rule means that nothing is left to do."""

    def __init__(self, rule: Rule) -> None:
        self.rule = rule
        self.avoided: list[list[Primitive]] = []

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        self.avoided.append(list(avoid))
        primitive = self.rule(heightmap, avoid)
        if primitive is None:
            raise NoActionError("nothing left")
        return Decision(
            primitive=primitive,
            rotation=0,
            row=0,
            col=0,
            q=0.0,
            maps=QMaps(push=EMPTY, grasp=EMPTY),
            verdict=None,
            seconds={},
        )


def grasp_highest(heightmap: Heightmap, avoid: Sequence[Primitive]) -> Primitive:
    """The middle of the highest thing seen; never mind what to avoid."""
    high = heightmap.height > np.nanmax(heightmap.height) - 0.002
    row, col = np.argwhere(high).mean(axis=0)
    x, y = heightmap.workspace.to_base(row, col)
    z = TABLE_Z + float(np.nanmax(heightmap.height))
    return Grasp(x=float(x), y=float(y), z=z, yaw=0.0)


class Recorder:
    """Keeps everything. `full`: the call in which the disk is full."""

    def __init__(self, full: str | None = None) -> None:
        self.full = full
        self.calls: list[str] = []
        self.outcomes: list[Outcome] = []
        self.refusals: list[str] = []
        self.result: EpisodeResult | None = None

    def _note(self, name: str) -> None:
        if name == self.full:
            raise LogError("no space left on device")
        if not self.calls or self.calls[-1] != name or name not in ("arm", "gripper"):
            self.calls.append(name)

    def observe(self, frame: RgbdFrame, heightmap: Heightmap) -> None:
        self._note("observe")

    def refused(self, decision: Decision, reason: str, *, stamp: float) -> None:
        self._note("refused")
        self.refusals.append(reason)

    def intend(self, decision: Decision, plan: Plan, *, stamp: float) -> None:
        self._note("intend")

    def arm_state(self, state: ArmState) -> None:
        self._note("arm")

    def gripper_state(self, state: GripperState) -> None:
        self._note("gripper")

    def conclude(self, outcome: Outcome, *, stamp: float) -> None:
        self._note("conclude")
        self.outcomes.append(outcome)

    def end(self, result: EpisodeResult, *, stamp: float) -> None:
        self._note("end")
        self.result = result


def limited(**limits: int) -> CellConfig:
    return CONFIG.model_copy(update={"episode": CONFIG.episode.model_copy(update=limits)})


def run(
    cell: Cell, rule: Rule = grasp_highest, log: Recorder | None = None, **options: object
) -> EpisodeResult:
    rng = np.random.default_rng(0)
    recorder = log if log is not None else Recorder()
    return run_episode(cell, Scripted(rule), rng=rng, log=recorder, **options)  # type: ignore[arg-type]


# --- endings ----------------------------------------------------------------------------------


def test_two_boxes_are_cleared_and_counted() -> None:
    table = Table(CONFIG, Box(x=0.45, y=0.1), Box(x=0.55, y=-0.1, height=0.07))
    log = Recorder()
    result = run(kinematic_cell(table), log=log)
    assert result.reason is EndReason.CLEARED
    assert (result.actions, result.grasps, result.grasp_successes, result.delivered) == (2,) * 4
    assert (result.pushes, result.refused, result.error, result.truth) == (0, 0, None, None)
    assert result.seconds == pytest.approx(table.now())
    assert log.result == result
    for outcome in log.outcomes:
        assert isinstance(outcome, GraspOutcome)
        assert outcome.held_by_width is outcome.gone_from_map is Verdict.YES


def test_calls_come_in_the_order_that_recorders_rely_on() -> None:
    table = Table(CONFIG, Box(x=0.45, y=0.1))
    log = Recorder()
    run(kinematic_cell(table), log=log)
    steady = [call for call in log.calls if call not in ("arm", "gripper")]
    assert steady == ["observe", "intend", "observe", "conclude", "end"]
    assert log.calls[:3] == ["observe", "intend", "gripper"]


def test_an_empty_table_is_cleared_without_moving() -> None:
    table = Table(CONFIG)
    arm = FakeArm(table)
    assert run(kinematic_cell(table, arm=arm)).reason is EndReason.CLEARED
    assert arm.motions == []


def test_a_blind_camera_is_not_an_empty_table() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0))
    arm = FakeArm(table)
    result = run(kinematic_cell(table, arm=arm, camera=FakeCamera(table, blind=True)))
    assert result.reason is EndReason.NOTHING_SEEN
    assert arm.motions == []


def test_ten_failures_in_a_row_are_stuck() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0), slippery=True)
    result = run(kinematic_cell(table))
    assert result.reason is EndReason.STUCK
    assert (result.actions, result.grasp_successes) == (10, 0)


def test_action_limit() -> None:
    table = Table(limited(max_actions=3), Box(x=0.5, y=0.0), slippery=True)
    result = run(kinematic_cell(table))
    assert (result.reason, result.actions) == (EndReason.ACTION_LIMIT, 3)


def test_no_action() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0))
    assert run(kinematic_cell(table), lambda *_: None).reason is EndReason.NO_ACTION


def shows(*boxes: Box) -> GoalPixels:
    """Goal pixels: all that is as far from the camera as the tops of these boxes."""

    def pixels(frame: RgbdFrame) -> npt.NDArray[np.bool_]:
        shown = np.zeros(frame.depth.shape, np.bool_)
        for box in boxes:
            shown |= np.isclose(frame.depth, CAMERA_HEIGHT - box.height)
        return shown

    return pixels


def grasp_goal(heightmap: Heightmap, avoid: Sequence[Primitive]) -> Primitive:
    assert heightmap.goal is not None
    only = np.where(heightmap.goal, heightmap.height, 0).astype(np.float32)
    return grasp_highest(replace(heightmap, height=only), avoid)


def test_a_goal_that_is_fetched_ends_the_episode_with_others_left() -> None:
    goal, other = Box(x=0.45, y=0.1, height=0.04), Box(x=0.55, y=-0.1, height=0.07)
    table = Table(CONFIG, goal, other)
    cell = kinematic_cell(table, goal_pixels=shows(goal))
    result = run(cell, grasp_goal, goal=True)
    assert (result.reason, result.actions) == (EndReason.GOAL_REACHED, 1)
    assert table.boxes == [other]


def test_a_goal_that_is_not_seen_is_lost() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0))
    cell = kinematic_cell(table, goal_pixels=shows())
    assert run(cell, goal=True).reason is EndReason.GOAL_LOST


def hides(pixels: GoalPixels, hidden: Callable[[], bool]) -> GoalPixels:
    def seen(frame: RgbdFrame) -> npt.NDArray[np.bool_]:
        return np.zeros(frame.depth.shape, np.bool_) if hidden() else pixels(frame)

    return seen


def away_then_goal(other: Box) -> Rule:
    """One grasp of another box, then all on the goal."""
    actions = iter([Grasp(x=other.x, y=other.y, z=TABLE_Z + other.height, yaw=0.0)])
    return lambda heightmap, avoid: next(actions, None) or grasp_goal(heightmap, avoid)


def test_a_goal_that_is_hidden_is_searched_for_where_it_was_seen() -> None:
    goal, other = Box(x=0.45, y=0.1, height=0.03), Box(x=0.55, y=-0.1, height=0.08)
    cover, far = Box(x=0.505, y=0.1, height=0.07), Box(x=0.45, y=-0.1, height=0.06)
    table = Table(CONFIG, goal, cover, other, far)
    hidden = hides(shows(goal), lambda: other not in table.boxes and cover in table.boxes)
    result = run(kinematic_cell(table, goal_pixels=hidden), away_then_goal(other), goal=True)
    assert (result.reason, result.actions) == (EndReason.GOAL_REACHED, 3)
    assert table.boxes == [far]


def test_the_search_for_a_hidden_goal_ends() -> None:
    goal = Box(x=0.4, y=0.1, height=0.03)
    heights = 0.04 + 0.005 * np.arange(MAX_SEARCHES + 2)
    others = [Box(x=0.6, y=0.055 * i - 0.19, height=float(h)) for i, h in enumerate(heights)]
    table = Table(CONFIG, goal, *others)
    hidden = hides(shows(goal), lambda: len(table.boxes) <= len(others))
    result = run(kinematic_cell(table, goal_pixels=hidden), goal=True)
    assert (result.reason, result.actions) == (EndReason.GOAL_LOST, 1 + MAX_SEARCHES)


def test_a_hidden_goal_is_lost_where_nothing_is_left_to_search() -> None:
    goal, other = Box(x=0.45, y=0.1, height=0.04), Box(x=0.55, y=-0.1, height=0.07)
    table = Table(CONFIG, goal, other)
    hidden = hides(shows(goal), lambda: other not in table.boxes)
    actions = iter([Grasp(x=other.x, y=other.y, z=TABLE_Z + other.height, yaw=0.0)])
    result = run(
        kinematic_cell(table, goal_pixels=hidden), lambda *_: next(actions, None), goal=True
    )
    assert (result.reason, result.actions) == (EndReason.GOAL_LOST, 1)


def sees_goal(side: int) -> Heightmap:
    """A square of that many pixels from row and column 100 on, 50 mm high."""
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[100 : 100 + side, 100 : 100 + side] = True
    return Heightmap(
        workspace=workspace_of(CONFIG),
        color=np.zeros((SIZE, SIZE, 3), np.uint8),
        height=np.where(goal, 0.05, 0.0).astype(np.float32),
        goal=goal,
    )


def test_a_grasp_near_what_little_is_seen_of_a_goal_has_not_fetched_it() -> None:
    before = sees_goal(5)
    x, y = (float(value) for value in before.workspace.to_base(102, 102))
    after = replace(before, goal=np.zeros((SIZE, SIZE), np.bool_))
    assert not took_goal(Grasp(x=x, y=y, z=-0.1, yaw=0.0), before, after)


@pytest.mark.parametrize(
    ("held", "seen", "gone"),
    [("yes", False, "yes"), ("yes", True, "no"), ("no", False, "no"), ("unknown", False, "no")],
)
def test_a_goal_that_is_held_and_no_longer_seen_is_gone(held: str, seen: bool, gone: str) -> None:
    """Though the heightmap is as before: what it leant on rolled into its place."""
    before = sees_goal(20)
    after = before if seen else replace(before, goal=np.zeros((SIZE, SIZE), np.bool_))
    x, y = (float(value) for value in before.workspace.to_base(110, 110))
    outcome = GraspOutcome(
        motion=Motion(contact=None, seconds=5.0),
        width_after_close=0.03,
        width_after_lift=0.03,
        held_by_width=Verdict(held),
        gone_from_map=Verdict.UNKNOWN,
    )
    told = witnessed(outcome, Grasp(x=x, y=y, z=-0.1, yaw=0.0), before, after)
    assert isinstance(told, GraspOutcome)
    assert told.gone_from_map is Verdict(gone)


def test_a_goal_that_nothing_can_tell_is_bad_input() -> None:
    with pytest.raises(ConfigError, match="which pixels show"):
        run(kinematic_cell(Table(CONFIG)), goal=True)


def test_an_operator_who_says_no_ends_it_before_anything_moves() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0))
    arm = FakeArm(table)
    result = run(kinematic_cell(table, arm=arm), confirm=lambda *_: False)
    assert result.reason is EndReason.OPERATOR_STOP
    assert arm.motions == []


# --- refusals and futile actions --------------------------------------------------------------


def test_a_refused_plan_is_told_and_the_next_best_is_tried() -> None:
    outside = Grasp(x=0.74, y=0.0, z=TABLE_Z + 0.05, yaw=np.pi / 2)

    def rule(heightmap: Heightmap, avoid: Sequence[Primitive]) -> Primitive:
        return grasp_highest(heightmap, avoid) if outside in avoid else outside

    table = Table(CONFIG, Box(x=0.5, y=0.0))
    log = Recorder()
    result = run(kinematic_cell(table), rule, log)
    assert (result.reason, result.refused, result.actions) == (EndReason.CLEARED, 1, 1)
    assert "lies outside the workspace x [0.276, 0.724]" in log.refusals[0]


def test_when_all_is_refused_there_is_no_action() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0))
    arm = FakeArm(table)
    outside = Grasp(x=0.74, y=0.0, z=TABLE_Z + 0.05, yaw=np.pi / 2)
    result = run(kinematic_cell(table, arm=arm), lambda *_: outside)
    assert (result.reason, result.refused) == (EndReason.NO_ACTION, MAX_REFUSALS)
    assert arm.motions == []


def test_what_failed_and_changed_nothing_is_avoided_until_the_map_changes_there() -> None:
    far, near = Box(x=0.6, y=0.15), Box(x=0.35, y=-0.1)
    table = Table(CONFIG, far, near)
    air = Push(x=0.30, y=-0.18, z=TABLE_Z, yaw=0.0, length=0.02)
    script: list[Primitive] = [
        air,
        Grasp(x=far.x, y=far.y, z=TABLE_Z + far.height, yaw=0.0),
        Grasp(x=near.x, y=near.y, z=TABLE_Z + near.height, yaw=0.0),
        air,
    ]
    policy = Scripted(lambda heightmap, avoid: script.pop(0))
    table.boxes.append(Box(x=0.65, y=-0.18))
    with pytest.raises(IndexError):  # the script is over
        run_episode(kinematic_cell(table), policy, rng=np.random.default_rng(0), log=Recorder())
    # The second grasp takes a box that stands within reach of the futile push.
    assert policy.avoided == [[], [air], [air], [], [air]]


def test_what_is_futile_is_tried_again_rather_than_nothing() -> None:
    """So that the stuck guard ends the episode, and not a short list of ideas."""

    def rule(heightmap: Heightmap, avoid: Sequence[Primitive]) -> Primitive | None:
        only = grasp_highest(heightmap, avoid)
        return None if only in avoid else only

    table = Table(limited(max_failures=4), Box(x=0.5, y=0.0), slippery=True)
    result = run(kinematic_cell(table), rule)
    assert (result.reason, result.actions) == (EndReason.STUCK, 4)


# --- when something fails ---------------------------------------------------------------------


@pytest.mark.parametrize("motion", range(5))
def test_a_device_error_in_any_motion_ends_in_a_stopped_arm_and_a_closed_log(motion: int) -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0))
    arm = FakeArm(table, fail_in=motion, failure=ProtectiveStop("joint 3 stopped"))
    log = Recorder()
    result = run(kinematic_cell(table, arm=arm), log=log)
    assert result.reason is EndReason.DEVICE_ERROR
    assert result.error == "ProtectiveStop: joint 3 stopped"
    assert arm.stops > 0
    assert log.calls[-1] == "end"
    assert log.result == result


def test_ctrl_c_ends_in_a_stopped_arm_and_a_closed_log() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0))
    arm = FakeArm(table, fail_in=2, failure=KeyboardInterrupt())
    log = Recorder()
    assert run(kinematic_cell(table, arm=arm), log=log).reason is EndReason.OPERATOR_STOP
    assert arm.stops > 0
    assert log.calls[-1] == "end"


def test_a_camera_that_fails_later_is_a_device_error() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0))
    camera = FakeCamera(table)

    def unplugged() -> None:
        if table.now() > 0:
            raise CameraError("unplugged")

    camera.before_capture = unplugged
    result = run(kinematic_cell(table, camera=camera))
    assert (result.reason, result.error) == (EndReason.DEVICE_ERROR, "CameraError: unplugged")
    assert result.actions == 0


@pytest.mark.parametrize("call", ["observe", "intend", "arm", "gripper", "conclude"])
def test_a_full_disk_stops_the_arm_and_is_raised(call: str) -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0))
    arm, log = FakeArm(table), Recorder(full=call)
    with pytest.raises(LogError, match="no space left"):
        run(kinematic_cell(table, arm=arm), log=log)
    assert arm.stops > 0
    assert log.result is not None
    assert log.result.reason is EndReason.FAILED


def test_a_bug_in_a_policy_is_not_swallowed() -> None:
    def broken(heightmap: Heightmap, avoid: Sequence[Primitive]) -> Primitive:
        raise ZeroDivisionError

    table = Table(CONFIG, Box(x=0.5, y=0.0))
    arm, log = FakeArm(table), Recorder()
    with pytest.raises(ZeroDivisionError):
        run(kinematic_cell(table, arm=arm), broken, log)
    assert arm.stops > 0
    assert log.calls[-1] == "end"
