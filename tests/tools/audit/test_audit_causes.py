"""Every cause, planted in a log and found by the audit of that log."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import nan, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_episode import ABOUT, WORKSPACE, Call, Synthetic, write_about

from policies.heightmap import Heightmap
from policies.policy import Decision
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import PlanRefused
from tdpg_deploy.motion import plan_primitive
from tdpg_deploy.outcome import EndReason, GraspOutcome, Motion, Outcome, PushOutcome, Verdict
from tdpg_deploy.safety import check
from tools.audit.causes import WHAT_TO_CHANGE, Cause
from tools.audit.rows import AuditedLog, audit_log

DOCS = Path(__file__).parents[3] / "docs"
CELL = load_cell(DEFAULT_CELL)
GRASP = Grasp(x=0.5, y=0.0, z=-0.12, yaw=0.3)
PUSH = Push(x=0.5, y=0.0, z=-0.15, yaw=0.0)
CLEARED = EpisodeResult(
    reason=EndReason.CLEARED, actions=1, grasps=1, pushes=0, grasp_successes=1, push_successes=0,
    delivered=1, refused=0, seconds=9.0,
)  # fmt: skip
MISSED = GraspOutcome(
    motion=Motion(contact=None, seconds=0.1),
    width_after_close=0.0004,
    width_after_lift=0.0004,
    held_by_width=Verdict.NO,
    gone_from_map=Verdict.NO,
)
HELD = replace(
    MISSED, width_after_close=0.03, width_after_lift=0.03, width_at_release=0.03,
    held_by_width=Verdict.YES, gone_from_map=Verdict.YES,
)  # fmt: skip
NO_EFFECT = PushOutcome(motion=Motion(contact=None, seconds=0.1), travelled=0.1, changed=Verdict.NO)


@dataclass
class Recipe:
    """Of a synthetic episode. frames: changes to the frames of its looks, in order."""

    synthetic: Synthetic = field(default_factory=Synthetic)
    calls: list[Call] = field(default_factory=list)
    frames: int = 0

    def look(self, heightmap: Heightmap | None = None, **changes: Any) -> None:
        frame = self.synthetic.frame(width=16, height=16)
        frame = replace(frame, **({"sequence": self.frames} | changes))
        self.frames = frame.sequence + 1
        heightmap = heightmap or self.synthetic.heightmap(self.synthetic.blocks(3))
        self.calls.append(Call(name="observe", arguments=(frame, heightmap)))

    def decision(self, primitive: Primitive) -> Decision:
        push = isinstance(primitive, Push)
        decision = self.synthetic.decision(self.synthetic.blocks(1), push=push)
        return replace(decision, primitive=primitive)

    def act(self, primitive: Primitive, outcome: Outcome | None, **frame: Any) -> None:
        plan = self.synthetic.plan(primitive)
        self.say("intend", self.decision(primitive), plan)
        for _ in range(48):  # the clock runs on
            self.synthetic.now()
        self.look(**frame)
        if outcome is not None:
            self.say("conclude", outcome)

    def refuse(self, primitive: Primitive, reason: str) -> None:
        self.say("refused", self.decision(primitive), reason)

    def end(self, reason: EndReason = EndReason.CLEARED, **changes: Any) -> None:
        self.say("end", replace(CLEARED, reason=reason, **changes))

    def say(self, name: str, *arguments: Any) -> None:
        self.calls.append(Call(name=name, arguments=arguments, stamp=self.synthetic.now()))

    def audit(self, path: Path) -> AuditedLog:
        write_about(path, self.calls, replace(ABOUT, scene=None), now=self.synthetic.now)
        return audit_log(path, name="planted")


@pytest.fixture
def recipe() -> Recipe:
    recipe = Recipe()
    recipe.look()
    return recipe


def only_action(log: AuditedLog) -> tuple[str | None, str]:
    (action,) = log.actions
    return action.cause, action.evidence or ""


# --- actions ----------------------------------------------------------------------------------

ACTIONS: list[tuple[Cause, Primitive, Outcome, str]] = [
    (Cause.MISSED_GRASP, GRASP, MISSED, "0.4 mm apart when closed"),
    (
        Cause.MISSED_GRASP,
        GRASP,
        replace(MISSED, width_after_lift=0.004, held_by_width=Verdict.UNKNOWN),
        "nothing left the map",
    ),
    (
        Cause.MISSED_GRASP,
        GRASP,
        replace(MISSED, gone_from_map=Verdict.YES),
        "after the lift; what stood there was pushed aside",
    ),
    (
        Cause.UNKNOWN,
        GRASP,
        replace(MISSED, width_after_close=0.0045, gone_from_map=Verdict.YES),
        "gone from the map: yes",
    ),
    (
        Cause.SLIP,
        GRASP,
        replace(MISSED, width_after_close=0.0312),
        "31.2 mm apart when closed and 0.4 mm after the lift",
    ),
    (
        Cause.SLIP,
        GRASP,
        replace(HELD, width_at_release=0.0, gone_from_map=Verdict.NO),
        "30.0 mm apart after the lift and 0.0 mm over the bin",
    ),
    (
        Cause.FINGER_ON_OBJECT,
        GRASP,
        replace(MISSED, motion=Motion(contact="descend", seconds=0.1), width_after_close=nan,
                width_after_lift=nan),
        'more than 15.0 N ended "descend"',
    ),
    (
        Cause.FINGER_ON_OBJECT,
        GRASP,
        replace(MISSED, motion=Motion(contact="lower", seconds=0.1), width_after_close=nan,
                width_after_lift=nan),
        'ended "lower", above what was seen there',
    ),
    (
        Cause.COLLISION,
        PUSH,
        replace(NO_EFFECT, motion=Motion(contact="push", seconds=0.1), travelled=0.031),
        'ended "push"',
    ),
    (Cause.PUSH_WITHOUT_EFFECT, PUSH, NO_EFFECT, "travelled 100.0 mm"),
    (
        Cause.UNKNOWN,
        GRASP,
        replace(HELD, gone_from_map=Verdict.NO),
        "held: yes (30.0 mm after the lift), gone from the map: no",
    ),
    (
        Cause.UNKNOWN,
        PUSH,
        replace(NO_EFFECT, changed=Verdict.UNKNOWN),
        "changed: unknown",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("cause", "primitive", "outcome", "numbers"), ACTIONS)
def test_a_failed_action(
    recipe: Recipe, tmp_path: Path, cause: Cause, primitive: Primitive, outcome: Outcome,
    numbers: str,
) -> None:  # fmt: skip
    recipe.act(primitive, outcome)
    recipe.end()
    found, evidence = only_action(recipe.audit(tmp_path / "log.mcap"))
    assert found == cause.value
    assert numbers in evidence


@pytest.mark.parametrize(
    ("primitive", "outcome"), [(GRASP, HELD), (PUSH, replace(NO_EFFECT, changed=Verdict.YES))]
)
def test_a_success_has_no_cause(
    recipe: Recipe, tmp_path: Path, primitive: Primitive, outcome: Outcome
) -> None:
    recipe.act(primitive, outcome)
    recipe.end()
    log = recipe.audit(tmp_path / "log.mcap")
    assert only_action(log) == (None, "")
    assert log.episode.causes == ()


@pytest.mark.parametrize(
    ("frame", "numbers"),
    [
        ({"captured_at": 5.0}, "s before the action was over"),
        ({"sequence": 0}, "frame 0 came after frame 0"),
    ],
)
def test_a_look_from_before_the_action_is_over(
    recipe: Recipe, tmp_path: Path, frame: dict[str, Any], numbers: str
) -> None:
    recipe.act(GRASP, MISSED, **frame)
    recipe.end()
    found, evidence = only_action(recipe.audit(tmp_path / "log.mcap"))
    assert found == Cause.STALE_FRAME.value
    assert numbers in evidence


@pytest.mark.parametrize(
    ("again", "is_same"),
    [
        (GRASP, True),
        (replace(GRASP, yaw=GRASP.yaw + pi), True),  # the gripper is symmetric
        (replace(GRASP, x=GRASP.x + 0.004, yaw=GRASP.yaw + 0.1), True),
        (replace(GRASP, x=GRASP.x + 0.02), False),
        (replace(GRASP, yaw=GRASP.yaw + pi / 8), False),
        (PUSH, False),
    ],
)
def test_the_same_action_again(
    recipe: Recipe, tmp_path: Path, again: Primitive, is_same: bool
) -> None:
    recipe.act(GRASP, MISSED)
    recipe.act(again, MISSED if isinstance(again, Grasp) else NO_EFFECT)
    recipe.end()
    first, second = recipe.audit(tmp_path / "log.mcap").actions
    assert first.cause == Cause.MISSED_GRASP.value
    assert (second.cause == Cause.REPEATED_ACTION.value) == is_same


# --- refusals, in the very words of those who refuse ------------------------------------------


def within(**limits: Any) -> CellConfig:
    return CELL.model_copy(update={"limits": CELL.limits.model_copy(update=limits)})


def refusal(
    primitive: Primitive, heightmap: Heightmap, *, plan: CellConfig = CELL, run: CellConfig = CELL
) -> str:
    """Of an action that is planned for one cell and checked for another."""
    with pytest.raises(PlanRefused) as caught:
        check(plan_primitive(primitive, heightmap, plan), run)
    return str(caught.value)


def table(hole: bool = False) -> Heightmap:
    height = np.full((224, 224), np.nan if hole else 0.0, np.float32)
    return Heightmap(workspace=WORKSPACE, color=np.zeros((224, 224, 3), np.uint8), height=height)


def test_refused_plans(recipe: Recipe, tmp_path: Path) -> None:
    near_border = replace(PUSH, x=WORKSPACE.x_max - 0.01)
    planted = [
        (Cause.DEPTH_HOLE, refusal(GRASP, table(hole=True))),
        (Cause.DEPTH_HOLE, refusal(replace(GRASP, z=nan), table())),
        (Cause.PUSH_OUT_OF_WORKSPACE, refusal(near_border, table())),
        (Cause.UNREACHABLE, refusal(GRASP, table(), plan=within(joint_range=(-0.1, 0.1)))),
        (Cause.UNREACHABLE, refusal(GRASP, table(), run=within(joint_range=(-0.1, 0.1)))),
        (Cause.REFUSED_PLAN, refusal(GRASP, table(), run=within(joint_speed=0.01))),
    ]
    for _, reason in planted:
        recipe.refuse(GRASP, reason)
    recipe.end(EndReason.NO_ACTION)
    log = recipe.audit(tmp_path / "log.mcap")
    assert log.actions[0].refusals == tuple(cause.value for cause, _ in planted)
    assert log.actions[0].kind == "none"
    assert log.episode.cause == Cause.DEPTH_HOLE.value  # the first of the most frequent
    assert log.episode.evidence is not None
    assert log.episode.evidence.startswith("2 of 6 refused: ")


# --- episodes ---------------------------------------------------------------------------------

ERRORS = [
    ("ProtectiveStop: protective stop: look at the arm", Cause.PROTECTIVE_STOP),
    ("EmergencyStop: emergency stop: release the button", Cause.OPERATOR_STOP),
    ("GripperError: gripper on /dev/x: fault 0x0A UNDERVOLTAGE", Cause.GRIPPER_FAULT),
    ("DeviceTimeout: gripper at h: did not activate before the deadline", Cause.GRIPPER_FAULT),
    ("DeviceTimeout: the motion did not end within 3 s: allow more", Cause.TIME_OUT),
    ("DeviceUnreachable: the arm is not connected", Cause.CONNECTION_LOST),
    (
        "CameraError: camera 42: depth and colour are 0.200 s apart; one of them has ceased",
        Cause.STALE_FRAME,
    ),
    (
        "CameraError: camera 42: its newest frame is 9.813 s old, exposed before it was asked for",
        Cause.STALE_FRAME,
    ),
    ("CameraError: camera 42: no pixel has depth; is the lens covered", Cause.DEPTH_HOLE),
    ('ArmError: "home" met more than 50.0 N on its way', Cause.COLLISION),
    ("CalibrationError: the table tags have moved by 2.10 px", Cause.CALIBRATION_DRIFT),
    ("DeviceUnreachable: x is camera 1; its calibration would be wrong", Cause.CALIBRATION_DRIFT),
    ("ArmError: mode POWER_OFF", Cause.UNKNOWN),
]


@pytest.mark.parametrize(("error", "cause"), ERRORS)
def test_a_device_that_failed(recipe: Recipe, tmp_path: Path, error: str, cause: Cause) -> None:
    recipe.end(EndReason.DEVICE_ERROR, error=error)
    episode = recipe.audit(tmp_path / "log.mcap").episode
    assert (episode.cause, episode.evidence) == (cause.value, error)


@pytest.mark.parametrize(
    ("reason", "error", "cause"),
    [
        (EndReason.DEVICE_ERROR, "ProtectiveStop: look at the arm", Cause.PROTECTIVE_STOP),
        (EndReason.OPERATOR_STOP, None, Cause.OPERATOR_STOP),
    ],
)
def test_an_action_that_was_interrupted_has_the_cause_of_it(
    recipe: Recipe, tmp_path: Path, reason: EndReason, error: str | None, cause: Cause
) -> None:
    """Its log is whole, though the action has no outcome."""
    recipe.act(GRASP, None)
    recipe.end(reason, error=error)
    log = recipe.audit(tmp_path / "log.mcap")
    assert only_action(log) == (cause.value, log.episode.evidence)


Plant = Callable[[Recipe], None]


def stuck(recipe: Recipe) -> None:
    recipe.act(PUSH, NO_EFFECT)
    for x in (0.4, 0.45, 0.5):
        recipe.act(replace(GRASP, x=x), MISSED)
    recipe.end(EndReason.STUCK, truth={"workspace": 3, "bin": 0, "outside": 0})


def pushed_out(recipe: Recipe) -> None:
    moved = replace(NO_EFFECT, travelled=0.1, changed=Verdict.YES)
    recipe.act(replace(PUSH, x=WORKSPACE.x_max - 0.13), moved)
    recipe.end(truth={"workspace": 0, "bin": 2, "outside": 1})


def goal_pushed_out(recipe: Recipe) -> None:
    moved = replace(NO_EFFECT, travelled=0.1, changed=Verdict.YES)
    recipe.act(replace(PUSH, x=WORKSPACE.x_max - 0.13), moved)
    recipe.end(EndReason.GOAL_LOST)


EPISODES: list[tuple[Cause, Plant, str]] = [
    (Cause.MISSED_GRASP, stuck, "3 missed grasp, 1 push without effect"),
    (Cause.PUSH_OUT_OF_WORKSPACE, pushed_out, "1 objects lie beside the workspace; action 1 ended"),
    (Cause.PUSH_OUT_OF_WORKSPACE, goal_pushed_out, "30 mm from the border"),
    (Cause.OPERATOR_STOP, lambda r: r.end(EndReason.OPERATOR_STOP), "the operator stopped"),
    (Cause.DEPTH_HOLE, lambda r: r.end(EndReason.NOTHING_SEEN), "too little"),
    (Cause.TIME_OUT, lambda r: r.end(EndReason.ACTION_LIMIT, actions=200), "200 actions"),
    (
        Cause.EMPTY_TABLE_MISJUDGED,
        lambda r: r.end(truth={"workspace": 2, "bin": 1, "outside": 0}),
        "while 2 objects lay",
    ),
    (
        Cause.EMPTY_TABLE_MISJUDGED,
        lambda r: r.end(EndReason.STUCK, truth={"workspace": 0, "bin": 3, "outside": 0}),
        "while nothing lay",
    ),
    (Cause.TRUNCATED_LOG, lambda r: r.act(GRASP, None), "ends before the episode did"),
    (Cause.UNKNOWN, lambda r: r.end(EndReason.NO_ACTION), "no action left"),
]


@pytest.mark.parametrize(("cause", "plant", "numbers"), EPISODES)
def test_an_episode_that_failed(
    recipe: Recipe, tmp_path: Path, cause: Cause, plant: Plant, numbers: str
) -> None:
    plant(recipe)
    episode = recipe.audit(tmp_path / "log.mcap").episode
    assert episode.cause == cause.value
    assert numbers in (episode.evidence or "")


def test_a_log_cut_off_by_a_kill(recipe: Recipe, tmp_path: Path) -> None:
    recipe.act(GRASP, HELD)
    recipe.act(GRASP, HELD)
    recipe.end()
    path = tmp_path / "log.mcap"
    recipe.audit(path)
    cut = tmp_path / "cut.mcap.part"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    log = audit_log(cut, name="cut")
    assert log.episode.cause == Cause.TRUNCATED_LOG.value
    assert "damaged at byte" in (log.episode.evidence or "")
    assert log.row is None
    assert log.episode.actions == 1


@pytest.mark.parametrize(
    ("lift", "tilt", "drifted"),
    [(0.0, 0.0, False), (0.004, 0.004, False), (0.012, 0.0, True), (-0.012, 0.0, True),
     (0.0, 0.02, True)],
)  # fmt: skip
def test_a_table_that_is_seen_elsewhere(
    tmp_path: Path, lift: float, tilt: float, drifted: bool
) -> None:
    recipe = Recipe()
    seen = recipe.synthetic.heightmap(recipe.synthetic.blocks(8))
    ramp = np.linspace(-tilt / 2, tilt / 2, 224, dtype=np.float32)[:, None]
    recipe.look(replace(seen, height=seen.height + np.float32(lift) + ramp))
    recipe.end()
    episode = recipe.audit(tmp_path / "log.mcap").episode
    assert episode.table_lift == pytest.approx(lift, abs=1e-3)
    assert episode.table_tilt == pytest.approx(tilt, abs=1e-3)
    assert (episode.cause == Cause.CALIBRATION_DRIFT.value) == drifted


def test_every_cause_is_planted() -> None:
    planted = {cause for cause, *_ in ACTIONS} | {cause for _, cause in ERRORS}
    planted |= {cause for cause, *_ in EPISODES}
    elsewhere = {Cause.REPEATED_ACTION, Cause.REFUSED_PLAN, Cause.UNREACHABLE}
    assert planted | elsewhere == set(Cause)


def test_each_cause_says_what_to_change_as_the_docs_do() -> None:
    text = (DOCS / "failures.md").read_text()
    rows = re.findall(r"^\| (.+?) \| (.+) \|$", text.partition("## What to change")[2], re.M)
    assert rows[1:] == [(cause.value, WHAT_TO_CHANGE[cause]) for cause in Cause]


def test_the_fields_to_change_are_in_the_cell_file() -> None:
    known = set(re.findall(r"`(\w+\.\w+)`", (DOCS / "cell-file.md").read_text()))
    named = re.findall(r"\b[a-z]+\.[a-z_]+\b", " ".join(WHAT_TO_CHANGE.values()))
    assert set(named) - {"faults.md"} <= known
