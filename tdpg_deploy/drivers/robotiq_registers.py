"""The registers of a Robotiq 2F-85, as values: bytes and counts in, SI units out.

2F-85 and 2F-140 instruction manual, chapter 4 "Control": six bytes of command from register
1000, six bytes of status from register 2000, high byte first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

COMMAND_ADDRESS = 1000
STATUS_ADDRESS = 2000
WORDS = 3

SPEED_RANGE = (0.020, 0.150)  # m/s at counts 0 and 255; manual, "Specifications"
FORCE_RANGE = (20.0, 235.0)  # N at counts 0 and 255; manual, "Specifications"

_ACTIVATE = 1 << 0
_GO_TO = 1 << 3


class Activation(IntEnum):
    """gSTA."""

    RESET = 0
    IN_PROGRESS = 1
    ACTIVE = 3


class Contact(IntEnum):
    """gOBJ. Means nothing before gPR echoes the request."""

    MOVING = 0
    WHILE_OPENING = 1
    WHILE_CLOSING = 2
    AT_REQUEST = 3


class Fault(IntEnum):
    """gFLT."""

    NONE = 0x0
    ACTION_DELAYED = 0x5
    NOT_ACTIVATED = 0x7
    OVERHEATED = 0x8
    SILENCE = 0x9
    UNDERVOLTAGE = 0xA
    AUTOMATIC_RELEASE = 0xB
    INTERNAL = 0xC
    ACTIVATION_FAILED = 0xD
    OVERCURRENT = 0xE
    AUTOMATIC_RELEASE_DONE = 0xF

    @property
    def is_major(self) -> bool:
        """Cleared only by a rising edge of rACT: the fingers hold nothing any more."""
        return self >= Fault.UNDERVOLTAGE

    @property
    def remedy(self) -> str:
        """What happened and what to do, in the manual's sense."""
        return _REMEDIES[self]


_REMEDIES = {
    Fault.NONE: "no fault",
    Fault.ACTION_DELAYED: "the activation is not complete: wait for it, then move",
    Fault.NOT_ACTIVATED: "the gripper is not activated: activate it, with the fingers clear",
    Fault.OVERHEATED: "hotter than 85 °C inside: let it cool below 80 °C, then use less force",
    Fault.SILENCE: "nobody spoke to the gripper for a second: check cable and converter",
    Fault.UNDERVOLTAGE: "supply below 21.6 V: check the 24 V supply, then activate again",
    Fault.AUTOMATIC_RELEASE: "automatic release in progress: wait for it, then activate again",
    Fault.INTERNAL: "internal fault: power-cycle the gripper; if it stays, ask Robotiq",
    Fault.ACTIVATION_FAILED: "the activation failed: free the fingers, then activate again",
    Fault.OVERCURRENT: "more than 1 A drawn: look for jammed fingers, then activate again",
    Fault.AUTOMATIC_RELEASE_DONE: "automatic release completed: activate again",
}


@dataclass(frozen=True, kw_only=True)
class Command:
    """What is written. Positions grow as the fingers close; all three are counts, 0..255."""

    activate: bool
    go_to: bool = False
    position: int = 0
    speed: int = 0
    force: int = 0

    def registers(self) -> tuple[int, int, int]:
        """Words for registers 1000 to 1002."""
        action = _ACTIVATE * self.activate | _GO_TO * self.go_to
        return action << 8, self.position, self.speed << 8 | self.force


@dataclass(frozen=True, kw_only=True)
class Status:
    """What is read. `echo` is the requested position as the gripper has understood it (gPR);
    `position` is measured (gPO), both in counts; current in amperes, None where unknown."""

    activated: bool
    going: bool
    activation: Activation
    contact: Contact
    fault: Fault
    echo: int
    position: int
    current: float | None

    @property
    def is_ready(self) -> bool:
        return self.activated and self.activation is Activation.ACTIVE


def parse_status(words: Sequence[int]) -> Status:
    """Status from registers 2000 to 2002. Raises ValueError on what no 2F-85 sends."""
    if len(words) != WORDS:
        raise ValueError(f"status has {WORDS} registers, got {len(words)}")
    action, fault_and_echo, position_and_current = words
    byte = action >> 8
    return Status(
        activated=bool(byte & _ACTIVATE),
        going=bool(byte & _GO_TO),
        activation=Activation(byte >> 4 & 0b11),
        contact=Contact(byte >> 6),
        fault=Fault(fault_and_echo >> 8 & 0x0F),  # the high nibble is the controller's
        echo=fault_and_echo & 0xFF,
        position=position_and_current >> 8,
        current=(position_and_current & 0xFF) * 0.010,  # 10 mA a count
    )


@dataclass(frozen=True, kw_only=True)
class CountScale:
    """Counts <-> metres between the pads, for one gripper with its fingers."""

    open_counts: int = 3  # gPO when fully open; differs by a few counts from gripper to gripper
    closed_counts: int = 228  # gPO when closed on nothing
    max_width: float = 0.085

    def width(self, counts: int) -> float:
        """Metres between the pads, within [0, max_width]."""
        share = (self.closed_counts - counts) / (self.closed_counts - self.open_counts)
        return min(max(share, 0.0), 1.0) * self.max_width

    def counts(self, width: float) -> int:
        """Nearest position request for a width in metres; out of range becomes the end."""
        share = min(max(width / self.max_width, 0.0), 1.0)
        return round(self.closed_counts - share * (self.closed_counts - self.open_counts))


def speed_counts(speed: float) -> int:
    """Nearest speed request (m/s), clamped to what the gripper can do."""
    return _counts(speed, SPEED_RANGE)


def force_counts(force: float) -> int:
    """Nearest force request (N), clamped to what the gripper can do."""
    return _counts(force, FORCE_RANGE)


def _counts(value: float, ends: tuple[float, float]) -> int:
    low, high = ends
    return round(255 * (min(max(value, low), high) - low) / (high - low))
