"""Entries -> steps. Pure, and lazy: it holds one step."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from tdpg_deploy.episode_log.entries import (
    Conclusion,
    Entry,
    Intent,
    Look,
    LookDocument,
    QPictures,
    Refusal,
    Step,
    ToolPoint,
)
from tdpg_deploy.errors import LogError
from tdpg_deploy.hal import GripperState
from tdpg_deploy.outcome import Outcome

# Of one step: half an hour at 100 Hz. A small hostile file may unpack to any number.
MAX_ENTRIES = 200_000


@dataclass
class _Open:
    """A step of which more may come."""

    look: Look | None = None
    refusals: list[Refusal] = field(default_factory=list)
    q_pictures: QPictures | None = None
    intent: Intent | None = None
    tool_path: list[ToolPoint] = field(default_factory=list)
    gripper_states: list[GripperState] = field(default_factory=list)
    next_look: Look | None = None
    seen: LookDocument | None = None
    next_seen: LookDocument | None = None

    def step(self, outcome: Outcome | None) -> Step:
        return Step(
            look=self.look,
            refusals=tuple(self.refusals),
            q_pictures=self.q_pictures,
            intent=self.intent,
            tool_path=tuple(self.tool_path),
            gripper_states=tuple(self.gripper_states),
            next_look=self.next_look,
            outcome=outcome,
            seen=self.seen,
            next_seen=self.next_seen,
        )

    def successor(self) -> _Open:
        return _Open(look=self.next_look, seen=self.next_seen)

    @property
    def size(self) -> int:
        return len(self.refusals) + len(self.tool_path) + len(self.gripper_states)

    @property
    def worth_telling(self) -> bool:
        return self.intent is not None or bool(self.refusals)


def group(entries: Iterable[Entry]) -> Iterator[Step]:
    """Steps in order. If `entries` breaks off with a LogError, the step in progress comes first."""
    current = _Open()
    try:
        for entry in entries:
            if current.size >= MAX_ENTRIES:
                raise LogError(f"a step of more than {MAX_ENTRIES} states and refusals")
            if isinstance(entry, Look | LookDocument):
                look, seen = (entry, entry.document) if isinstance(entry, Look) else (None, entry)
                if current.intent is None:
                    current.look, current.seen = look, seen
                else:
                    current.next_look, current.next_seen = look, seen
            elif isinstance(entry, Refusal | QPictures | Intent):
                if current.intent is not None:  # its conclusion is lost
                    yield current.step(None)
                    current = current.successor()
                if isinstance(entry, Refusal):
                    current.refusals.append(entry)
                elif isinstance(entry, QPictures):
                    current.q_pictures = entry
                else:
                    current.intent = entry
            elif isinstance(entry, ToolPoint):
                current.tool_path.append(entry)
            elif isinstance(entry, GripperState):
                current.gripper_states.append(entry)
            elif isinstance(entry, Conclusion):
                yield current.step(entry.outcome)
                current = current.successor()
    except LogError:
        if current.worth_telling:
            yield current.step(None)
        raise
    if current.worth_telling:
        yield current.step(None)
