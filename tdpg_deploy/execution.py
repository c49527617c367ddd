"""A checked plan on a cell -> what was measured. Whatever goes wrong, the arm is stopped.

A guarded motion that touches something ends the approach: the tool goes straight up from where
it stands and home. That is a failed action, not an error, unless something hangs on the fingers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from policies.primitives import Grasp
from tdpg_deploy.cell import Cell
from tdpg_deploy.errors import ArmError, DeviceError, GripperError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import ArmState, GripperState, MotionEnd, MotionResult, OnArmState
from tdpg_deploy.motion import plan_homing
from tdpg_deploy.outcome import (
    EMPTY_BELOW,
    HELD_ABOVE,
    GraspOutcome,
    Motion,
    Outcome,
    PushOutcome,
    Verdict,
)
from tdpg_deploy.plan import MoveFingers, MoveJoints, MoveLinear, Plan, Step
from tdpg_deploy.safety import check_steps

OnGripperState: TypeAlias = Callable[[GripperState], None]

AT_HOME = 0.01  # rad
_GRACE = 3.0  # s that a motion may take beyond twice its ideal time


def execute(
    plan: Plan,
    cell: Cell,
    *,
    on_state: OnArmState | None = None,
    on_gripper: OnGripperState | None = None,
) -> Outcome:
    """Run a plan that has passed `safety.check`, the arm being at home.

    The outcome's witness from the heightmap is UNKNOWN until `change` has seen the next frame.
    Raises DeviceError; the arm is then stopped, wherever it is. GripperError: also when something
    hangs on the fingers.
    """
    run = _Run(cell, on_state, on_gripper)
    with _stopped_on_error(cell):
        if isinstance(plan.primitive, Grasp):
            return _grasp(plan, run)
        return _push(plan, run)


def make_ready(
    cell: Cell, *, on_state: OnArmState | None = None, on_gripper: OnGripperState | None = None
) -> None:
    """Bring the arm home and activate the gripper, whatever was before.

    Raises PlanRefused, before anything moves, when the straight way home is not safe.
    """
    run = _Run(cell, on_state, on_gripper)
    state = cell.arm.state()
    with _stopped_on_error(cell):
        if np.abs(state.q - cell.config.arm.home).max() > AT_HOME:
            steps = plan_homing(state.X_base_tool, cell.config)
            check_steps(steps, state.q, cell.config)
            for step in steps:
                run.step(step)
        cell.gripper.activate()


def held(width: float, max_width: float) -> Verdict:
    """Whether something keeps the pads apart that were told to close. Pads that hardly left
    their open place say nothing: the fingers may be blocked."""
    if not np.isfinite(width) or EMPTY_BELOW <= width <= HELD_ABOVE:
        return Verdict.UNKNOWN
    if width > max_width - EMPTY_BELOW:
        return Verdict.UNKNOWN
    return Verdict.YES if width > HELD_ABOVE else Verdict.NO


# --- the two primitives -----------------------------------------------------------------------


def _grasp(plan: Plan, run: _Run) -> GraspOutcome:
    started, max_width = run.cell.clock.now(), run.cell.gripper.max_width
    approach = run.approach(plan.approach)
    after_close = after_lift = at_release = float("nan")
    verdict = Verdict.NO
    if approach.contact is None:  # else the fingers are open
        after_close = approach.width
        after_lift = run.width()
        verdict = held(after_lift, max_width)
        if verdict is not Verdict.NO:
            at_release = run.delivery(plan.delivery)
    run.steps(plan.retreat)
    run.check_nothing_hangs(approach)
    return GraspOutcome(
        motion=Motion(contact=approach.contact, seconds=run.cell.clock.now() - started),
        width_after_close=after_close,
        width_after_lift=after_lift,
        width_at_release=at_release,
        held_by_width=verdict,
        gone_from_map=Verdict.UNKNOWN,
    )


def _push(plan: Plan, run: _Run) -> PushOutcome:
    started = run.cell.clock.now()
    approach = run.approach(plan.approach)
    run.steps(plan.retreat)
    run.check_nothing_hangs(approach)
    return PushOutcome(
        motion=Motion(contact=approach.contact, seconds=run.cell.clock.now() - started),
        travelled=approach.travelled,
        changed=Verdict.UNKNOWN,
    )


@dataclass(frozen=True, kw_only=True)
class _Approach:
    """contact: the step that force ended, if any. width: of the pads after they last moved, m.
    travelled: metres that the tool got from where it came down, level with the table."""

    contact: str | None
    width: float
    travelled: float


# --- steps ------------------------------------------------------------------------------------


class _Run:
    """Runs steps, each with a deadline, and passes on what is measured on the way."""

    def __init__(
        self, cell: Cell, on_state: OnArmState | None, on_gripper: OnGripperState | None
    ) -> None:
        self.cell = cell
        self._on_state = on_state
        self._on_gripper = on_gripper

    def approach(self, steps: Sequence[Step]) -> _Approach:
        """All but the last step, until a contact; then the last one, the lift."""
        *ahead, lift = steps
        assert isinstance(lift, MoveLinear)
        contact, width, travelled = None, float("nan"), 0.0
        start = None  # of the guarded motions: at rest in free space above
        for step in ahead:
            if isinstance(step, MoveLinear):
                if start is None:
                    self.cell.arm.zero_force()
                    start = self.cell.arm.state().X_base_tool.translation
                result = self.linear(step)
                way = result.state.X_base_tool.translation - start
                travelled = max(travelled, float(np.hypot(*way[:2])))
                if result.end is MotionEnd.CONTACT:
                    contact = step.name
                    break
            elif isinstance(step, MoveFingers):
                width = self.fingers(step).width
            else:
                self.joints(step)
        if self._lift(lift) is MotionEnd.CONTACT:
            contact = contact or lift.name
        return _Approach(contact=contact, width=width, travelled=travelled)

    def _lift(self, lift: MoveLinear) -> MotionEnd:
        """Straight up. When something holds the arm back: let go of it, then up again."""
        end = self.linear(_from_here(lift, self.cell.arm.state())).end
        if end is MotionEnd.CONTACT:
            self.fingers(self._finger_step("let go", self.cell.gripper.max_width))
            again = self.linear(_from_here(lift, self.cell.arm.state()))
            if again.end is MotionEnd.CONTACT:
                raise ArmError(
                    f"the arm is caught at {again.state.X_base_tool.translation.round(3)} m: "
                    f"lifting meets more than {lift.stop_force} N; free it by hand"
                )
        return end

    def check_nothing_hangs(self, approach: _Approach) -> None:
        """After a contact, at home. What met something may be a mug whose handle a finger went
        through, and no release frees that. Raises GripperError when the pads do not meet."""
        if approach.contact is None:
            return
        width = self.fingers(self._finger_step("check", 0.0)).width
        if held(width, self.cell.gripper.max_width) is Verdict.YES:
            raise GripperError(
                f"something hangs on the fingers: closed in free air they stay {width * 1e3:.1f} "
                f'mm apart, after "{approach.contact}" met something; take it off by hand'
            )

    def _finger_step(self, name: str, width: float) -> MoveFingers:
        gripper = self.cell.config.gripper
        return MoveFingers(name=name, width=width, speed=gripper.speed, force=gripper.force)

    def delivery(self, steps: Sequence[Step]) -> float:
        """To the bin; the width (m) between the pads just before they let go."""
        at_release = float("nan")
        for step in steps:
            if isinstance(step, MoveFingers):
                at_release = self.width()
            self.step(step)
        return at_release

    def steps(self, steps: Sequence[Step]) -> None:
        for step in steps:
            self.step(step)

    def step(self, step: Step) -> None:
        """One that has to arrive. Raises ArmError when force ends it."""
        if isinstance(step, MoveFingers):
            self.fingers(step)
        elif isinstance(step, MoveJoints):
            self.joints(step)
        elif self.linear(step).end is MotionEnd.CONTACT:
            raise ArmError(f'"{step.name}" met more than {step.stop_force} N on its way')

    def joints(self, step: MoveJoints) -> MotionResult:
        turn = float(np.abs(step.q - self.cell.arm.state().q).max())
        return self.cell.arm.move_joints(
            step.q,
            speed=step.speed,
            acceleration=step.acceleration,
            deadline=_deadline(turn, step.speed, step.acceleration),
            on_state=self._on_state,
        )

    def linear(self, step: MoveLinear) -> MotionResult:
        distance, angle = self.cell.arm.state().X_base_tool.distance(step.X_base_tool)
        return self.cell.arm.move_linear(
            step.X_base_tool,
            speed=step.speed,
            acceleration=step.acceleration,
            deadline=_deadline(distance + angle, step.speed, step.acceleration),
            stop_force=step.stop_force,
            on_state=self._on_state,
        )

    def fingers(self, step: MoveFingers) -> GripperState:
        state = self.cell.gripper.move(
            step.width,
            speed=step.speed,
            force=step.force,
            deadline=_GRACE + 2 * self.cell.gripper.max_width / step.speed,
        )
        if self._on_gripper is not None:
            self._on_gripper(state)
        return state

    def width(self) -> float:
        """Metres between the pads now."""
        state = self.cell.gripper.state()
        if self._on_gripper is not None:
            self._on_gripper(state)
        return state.width


def _deadline(way: float, speed: float, acceleration: float) -> float:
    """Seconds: twice what a trapezoid of speed takes, and some grace."""
    return 2 * (way / speed + speed / acceleration) + _GRACE


def _from_here(lift: MoveLinear, state: ArmState) -> MoveLinear:
    """After a contact the arm does not stand where the plan had it: go straight up, no slant."""
    here = state.X_base_tool
    up = np.array([*here.translation[:2], lift.X_base_tool.translation[2]])
    return replace(lift, X_base_tool=Transform(here.rotation, up))


@contextmanager
def _stopped_on_error(cell: Cell) -> Iterator[None]:
    try:
        yield
    except BaseException:  # Ctrl-C too
        with suppress(DeviceError):  # the first error is the one to report
            cell.arm.stop()
        raise
