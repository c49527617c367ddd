"""What the operator sees while an episode runs: a line for each action, and one that moves."""

from __future__ import annotations

from types import TracebackType

import numpy as np
from rich.console import Console
from rich.status import Status

from policies.heightmap import Heightmap
from policies.policy import Decision
from policies.primitives import Grasp
from tdpg_deploy.episode_record import EpisodeRecorder, EpisodeResult
from tdpg_deploy.hal import GripperState, OnArmState, RgbdFrame
from tdpg_deploy.outcome import GraspOutcome, Outcome, Verdict
from tdpg_deploy.plan import MoveFingers, MoveJoints, Plan, Step

MARKS = {Verdict.YES: "[green]success[/]", Verdict.NO: "[red]failed[/]", Verdict.UNKNOWN: "unclear"}


class Live:
    """The terminal during one episode. objects: how many lie on the table, if that is known."""

    def __init__(self, console: Console, *, objects: int | None) -> None:
        self.console = console
        self.status = Status("connecting", console=console)
        self._objects = objects
        self._actions = 0
        self._grasped = 0
        self._refused = 0
        self._line = ""

    def __enter__(self) -> Live:
        self.status.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.status.stop()

    def before(self, recorder: EpisodeRecorder) -> EpisodeRecorder:
        """A recorder that shows what it passes on."""
        return _Shown(recorder, self)

    def confirm_first(self, decision: Decision, plan: Plan) -> bool:
        """Ask before the first action only."""
        return self._actions > 0 or self.confirm(decision, plan)

    def confirm(self, decision: Decision, plan: Plan) -> bool:
        """Show the plan and ask before an action; anything but y is a no."""
        self.status.stop()
        steps = (*plan.approach, *plan.delivery, *plan.retreat)
        for line in (*plan.notes, *map(describe_step, steps)):
            self.console.print(line, markup=False, soft_wrap=True)
        answer = self.console.input(f"{describe(decision)}. Go? (y/N) ")
        self.status.start()
        return answer.strip().lower() in ("y", "yes")

    def observes(self) -> None:
        self.status.update("deciding")

    def refused(self, reason: str) -> None:
        self._refused += 1
        self.status.update(f"refused: {reason}")

    def intends(self, decision: Decision) -> None:
        self._actions += 1
        milliseconds = 1000 * sum(decision.seconds.values())
        self._line = f"{self._actions:3d}  {describe(decision)}  {milliseconds:4.0f} ms"
        self.status.update(self._line.strip())

    def concludes(self, outcome: Outcome) -> None:
        note = ""
        if outcome.motion.contact is not None:
            note = f"  touched something: {outcome.motion.contact}"
        elif isinstance(outcome, GraspOutcome) and outcome.success is Verdict.YES:
            self._grasped += 1
            note = f"  {outcome.width_after_lift * 1000:.0f} mm wide"
        of = "" if self._objects is None else f" of {self._objects}"
        tally = f"{self._grasped}{of}"
        if self._refused:
            tally += f", {self._refused} refused before"
        self._refused = 0
        self.console.print(
            f"{self._line}  {MARKS[outcome.success]}{note}  [dim]{tally}[/]", soft_wrap=True
        )


def describe(decision: Decision) -> str:
    kind = "grasp" if isinstance(decision.primitive, Grasp) else "push"
    p = decision.primitive
    text = f"{kind:5s} at ({p.x:.3f}, {p.y:+.3f}) m  q {decision.q:5.2f}"
    if decision.p_foreseen is not None:
        text += f"  foreseen {decision.p_foreseen:4.0%}"
    return text


def describe_step(step: Step) -> str:
    """Name, goal and limits in a line."""
    if isinstance(step, MoveFingers):
        what = f"pads {step.width * 1e3:.0f} mm apart, at most {step.force:.0f} N"
    elif isinstance(step, MoveJoints):
        degrees = ", ".join(f"{angle:.0f}" for angle in np.degrees(step.q))
        what = f"joints at {degrees} deg, {step.speed:.3g} rad/s"
    else:
        x, y, z = step.X_base_tool.translation
        what = f"tool at {x:.3f}, {y:.3f}, {z:.3f} m, {step.speed:.3g} m/s"
        if step.stop_force is not None:
            what += f", stops above {step.stop_force:.0f} N"
    return f"  {step.name:13s} {what}"


class _Shown:
    """An EpisodeRecorder before another one."""

    def __init__(self, recorder: EpisodeRecorder, live: Live) -> None:
        self._recorder = recorder
        self._live = live

    def observe(self, frame: RgbdFrame, heightmap: Heightmap) -> None:
        self._recorder.observe(frame, heightmap)
        self._live.observes()

    def refused(self, decision: Decision, reason: str, *, stamp: float) -> None:
        self._recorder.refused(decision, reason, stamp=stamp)
        self._live.refused(reason)

    def intend(self, decision: Decision, plan: Plan, *, stamp: float) -> None:
        self._recorder.intend(decision, plan, stamp=stamp)
        self._live.intends(decision)

    @property
    def arm_state(self) -> OnArmState | None:
        return self._recorder.arm_state

    def gripper_state(self, state: GripperState) -> None:
        self._recorder.gripper_state(state)

    def conclude(self, outcome: Outcome, *, stamp: float) -> None:
        self._recorder.conclude(outcome, stamp=stamp)
        self._live.concludes(outcome)

    def end(self, result: EpisodeResult, *, stamp: float) -> None:
        self._recorder.end(result, stamp=stamp)
