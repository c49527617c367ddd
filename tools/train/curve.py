"""The curve of a run: one line of JSON a round, and the same for TensorBoard."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from tensorboardX import SummaryWriter

LINES = "curve.jsonl"
EVENTS = "tensorboard"


@dataclass(frozen=True, kw_only=True)
class Validation:
    """Greedy episodes on validation tables: means over all of them. None: nothing was tried."""

    completion: float
    grasp_success: float | None
    efficiency: float | None
    motions: float


@dataclass(frozen=True, kw_only=True)
class Progress:
    """What a round brought. actions, updates: of the run so far. grasp_success: share of the
    round's grasps; push_reward: mean of its pushes. td_error: mean of |Q - y|. None: of nothing."""

    round: int
    stage: str
    actions: int
    updates: int
    epsilon: float
    learning_rate: float
    grasp_success: float | None
    push_reward: float | None
    huber: float | None
    bce: float | None
    td_error: float | None
    validation: Validation | None


@dataclass(frozen=True, kw_only=True)
class Compared:
    """What came of several actions from one look, 0 to 1, as a mean over looks: of the one that is
    valued most, of any of them, and of the best of them."""

    chosen: float
    any: float
    best: float


@dataclass(frozen=True, kw_only=True)
class PushValidation:
    """By pushes of tables held out. loss: binary cross-entropy. goal: how often one object came
    free; all: which share of a table needs no other push. None: of nothing."""

    loss: float
    goal: Compared | None
    all: Compared | None


@dataclass(frozen=True, kw_only=True)
class GraspValidation:
    """By grasps of tables held out. loss: binary cross-entropy. held: how often."""

    loss: float
    held: Compared | None


@dataclass(frozen=True, kw_only=True)
class CourseProgress:
    """What an epoch of a course brought. actions: updates so far."""

    round: int
    actions: int
    learning_rate: float
    loss: float
    validation: PushValidation | GraspValidation


class Curve:
    """Appends to the curve in a run's directory; what lies after `round` is of a round that was
    killed before it was saved, and is dropped."""

    def __init__(self, directory: Path, *, round: int) -> None:
        self._path = directory / LINES
        kept = [line for line in read_curve(directory) if line["round"] <= round]
        self._path.write_text("".join(json.dumps(line) + "\n" for line in kept), encoding="utf-8")
        actions = kept[-1]["actions"] if kept else 0
        self._events = SummaryWriter(str(directory / EVENTS), purge_step=actions + 1)

    def __enter__(self) -> Curve:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._events.close()

    def add(self, progress: Progress | CourseProgress) -> None:
        line = dataclasses.asdict(progress)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        for group, values in (("train", line), ("validation", line["validation"] or {})):
            for name, value in values.items():
                if isinstance(value, float):
                    self._events.add_scalar(f"{group}/{name}", value, progress.actions)
        self._events.flush()


def read_curve(directory: Path) -> list[dict[str, Any]]:
    """The rounds of a run, one dict each, as Progress has them; empty before the first."""
    path = directory / LINES
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
