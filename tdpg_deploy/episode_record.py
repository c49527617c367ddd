"""What an episode tells while it runs, and what it sums up at its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from policies.heightmap import Heightmap
from policies.policy import Decision
from tdpg_deploy.hal import GripperState, OnArmState, RgbdFrame
from tdpg_deploy.outcome import EndReason, Outcome
from tdpg_deploy.plan import Plan


@dataclass(frozen=True, kw_only=True)
class EpisodeResult:
    """How an episode went, by what was measured.

    actions: plans that were executed; grasps, pushes: of these. grasp_successes,
    push_successes: outcomes whose `success` is YES; unknown counts as no success.
    delivered: held objects that were let go above the bin. refused: plans that did not pass.
    seconds: of the cell's clock. error: the device error that ended it, if one did.
    truth: what the simulated world counted, for judging only; None on a real cell.
    """

    reason: EndReason
    actions: int
    grasps: int
    pushes: int
    grasp_successes: int
    push_successes: int
    delivered: int
    refused: int
    seconds: float
    error: str | None = None
    truth: Mapping[str, int] | None = None


class EpisodeRecorder(Protocol):
    """Listens to one episode. `stamp` is in seconds on the cell's clock.

    An action's outcome is known only after the next look, so the order of calls is

        observe (refused* intend state* observe conclude)* refused* end

    where state is arm_state or gripper_state. An error cuts it short; `end` still comes.
    """

    def observe(self, frame: RgbdFrame, heightmap: Heightmap) -> None:
        """A look at the table, the arm being out of sight."""

    def refused(self, decision: Decision, reason: str, *, stamp: float) -> None:
        """A decision whose plan may not be run, and why. The next best one is tried."""

    def intend(self, decision: Decision, plan: Plan, *, stamp: float) -> None:
        """Before anything moves; what was said up to here must survive a crash."""

    @property
    def arm_state(self) -> OnArmState | None:
        """Told what is measured while moving, 20 Hz or more. None saves the measuring."""

    def gripper_state(self, state: GripperState) -> None:
        """Measured after each move of the fingers, and while holding."""

    def conclude(self, outcome: Outcome, *, stamp: float) -> None:
        """What the last intended action did; flush here."""

    def end(self, result: EpisodeResult, *, stamp: float) -> None:
        """Called once, however the episode ended, last of all."""


class NullRecorder:
    """Records nothing: for training and evaluation."""

    def observe(self, frame: RgbdFrame, heightmap: Heightmap) -> None:
        pass

    def refused(self, decision: Decision, reason: str, *, stamp: float) -> None:
        pass

    def intend(self, decision: Decision, plan: Plan, *, stamp: float) -> None:
        pass

    arm_state = None

    def gripper_state(self, state: GripperState) -> None:
        pass

    def conclude(self, outcome: Outcome, *, stamp: float) -> None:
        pass

    def end(self, result: EpisodeResult, *, stamp: float) -> None:
        pass
