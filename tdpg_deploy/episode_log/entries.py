"""What a log tells: the entries of an episode, in the order in which they happened.

Times are seconds on the cell's clock, kept to the nanosecond.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from policies.heightmap import Heightmap
from policies.policy import CriticVerdict, Decision
from policies.primitives import Primitive
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.hal import ArmState, GripperState, RgbdFrame
from tdpg_deploy.outcome import Outcome
from tdpg_deploy.plan import Plan


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """The best action of one kind in one rotation: its value and place in the Q-maps."""

    q: float
    rotation: int
    row: int
    col: int


@dataclass(frozen=True, kw_only=True)
class LoggedDecision:
    """A Decision without its Q-maps, which would outweigh all the rest of a log.

    pushes, grasps: the best action of each rotation that allows one. maps_sha256: of both maps'
    bytes, so that a decision made again from the logged heightmap can be compared bit for bit.
    """

    primitive: Primitive
    rotation: int
    row: int
    col: int
    q: float
    verdict: CriticVerdict | None
    seconds: dict[str, float]
    pushes: tuple[Candidate, ...]
    grasps: tuple[Candidate, ...]
    maps_sha256: str
    p_foreseen: float | None = None

    @classmethod
    def of(cls, decision: Decision) -> LoggedDecision:
        digest = hashlib.sha256()
        for maps in (decision.maps.push, decision.maps.grasp):
            digest.update(np.ascontiguousarray(maps, "<f4").data)
        return cls(
            primitive=decision.primitive,
            rotation=int(decision.rotation),
            row=int(decision.row),
            col=int(decision.col),
            q=float(decision.q),
            verdict=decision.verdict,
            seconds=dict(decision.seconds),
            pushes=_best_by_rotation(decision.maps.push),
            grasps=_best_by_rotation(decision.maps.grasp),
            maps_sha256=digest.hexdigest(),
            p_foreseen=decision.p_foreseen,
        )


def _best_by_rotation(maps: npt.NDArray[np.float32]) -> tuple[Candidate, ...]:
    best = maps.reshape(len(maps), -1).argmax(axis=1)
    rows, cols = np.unravel_index(best, maps.shape[1:])
    candidates = (
        Candidate(q=float(maps[k, row, col]), rotation=k, row=int(row), col=int(col))
        for k, (row, col) in enumerate(zip(rows, cols, strict=True))
    )
    return tuple(c for c in candidates if np.isfinite(c.q))


@dataclass(frozen=True, kw_only=True)
class LookDocument:
    """Closes a look: what its images do not say. It stands for the look where they stay unread."""

    sequence: int
    serial: str
    captured_at: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """A frame, and the heightmap that was made of it."""

    frame: RgbdFrame
    heightmap: Heightmap

    @property
    def document(self) -> LookDocument:
        frame = self.frame
        return LookDocument(
            sequence=frame.sequence, serial=frame.serial, captured_at=frame.captured_at
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class QPictures:
    """Pictures of a decision's Q-maps: (448, 448, 3) uint8 RGB, brighter is better."""

    push: npt.NDArray[np.uint8]
    grasp: npt.NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """A decision whose plan was not run, and why."""

    decision: LoggedDecision
    reason: str
    stamp: float


@dataclass(frozen=True, kw_only=True)
class Intent:
    """A decision and its plan, before anything moved."""

    decision: LoggedDecision
    plan: Plan
    stamp: float


@dataclass(frozen=True, kw_only=True)
class Conclusion:
    """What the last intended action did."""

    outcome: Outcome
    stamp: float


@dataclass(frozen=True, kw_only=True)
class End:
    """How the episode went."""

    result: EpisodeResult
    stamp: float


@dataclass(frozen=True, kw_only=True)
class ToolPoint:
    """What a step keeps of an arm state, at a tenth of the cost of reading all of it: where the
    tool was (m, in base) and how strong the force on it (N)."""

    p_base: tuple[float, float, float]
    force: float
    stamp: float


Entry: TypeAlias = (
    Look
    | LookDocument
    | Refusal
    | QPictures
    | Intent
    | ArmState
    | ToolPoint
    | GripperState
    | Conclusion
    | End
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One planned action; or, as the last of an episode, refusals that led to none.

    look, next_look: what was seen before and after; like q_pictures None if images were left out
    or are lost. seen, next_seen: when that was, told without images too.
    outcome: None if the log ends before it was known.
    """

    look: Look | None
    refusals: tuple[Refusal, ...]
    q_pictures: QPictures | None
    intent: Intent | None
    tool_path: tuple[ToolPoint, ...]
    gripper_states: tuple[GripperState, ...]
    next_look: Look | None
    outcome: Outcome | None
    seen: LookDocument | None = None
    next_seen: LookDocument | None = None


# --- documents that complete the images and states of other channels ---------------------------


@dataclass(frozen=True, kw_only=True)
class PlanDocument:
    """Closes an intent, after its decision."""

    plan: Plan
    stamp: float


@dataclass(frozen=True, kw_only=True)
class ForceDocument:
    """Closes an arm state: newtons at the tool along the axes of base, and their norm."""

    x: float
    y: float
    z: float
    norm: float
    stamp: float


@dataclass(frozen=True, kw_only=True)
class ForceNorm:
    """What a ToolPoint takes of a ForceDocument."""

    norm: float
    stamp: float
