"""A Robotiq 2F-85 as its registers show it: fingers that take time, contacts, faults.

Registers and behaviour after the 2F-85 instruction manual, chapter 4, written without regard
to our driver. The wires in front are in robotiq_wires.py.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

OPEN_COUNTS, CLOSED_COUNTS = 3, 228
STROKE = 0.085  # m
SLOWEST, FASTEST = 0.020, 0.150  # m/s at rSP 0 and 255
WEAKEST, STRONGEST = 20.0, 235.0  # N at rFR 0 and 255

ECHO_LATENCY = 0.004  # s from a written request to its echo
SILENCE_LIMIT = 1.0  # s without traffic until fault 9

COMMAND, STATUS = range(1000, 1003), range(2000, 2003)


class FaultCode(IntEnum):
    """gFLT."""

    NONE = 0x0
    DELAYED = 0x5
    INACTIVE = 0x7
    HOT = 0x8
    SILENCE = 0x9
    UNDERVOLTAGE = 0xA
    RELEASING = 0xB
    INTERNAL = 0xC
    ACTIVATION = 0xD
    OVERCURRENT = 0xE
    RELEASED = 0xF


@dataclass(frozen=True, kw_only=True)
class JawsState:
    """Metres between the pads, and whether the fingers travel."""

    width: float
    moving: bool


class Jaws(Protocol):
    """The fingers behind the registers: a simulated world's, or `KinematicJaws`."""

    def drive(self, width: float, *, speed: float, force: float) -> None:
        """Start towards `width` (m) at `speed` (m/s), pressing at most `force` (N)."""

    def halt(self) -> None: ...

    def state(self) -> JawsState: ...


class KinematicJaws:
    """Fingers that travel at the speed asked for, as far as something lets them.

    span: (narrowest, widest) width in metres that objects leave free now; an object of 30 mm
    between the pads is (0.030, 0.085).
    """

    def __init__(
        self,
        now: Callable[[], float],
        *,
        span: Callable[[], tuple[float, float]] = lambda: (0.0, STROKE),
        width: float = STROKE,
    ) -> None:
        self._now = now
        self._span = span
        self._width = self._target = width
        self._speed = 0.0
        self.force = 0.0  # as last asked for
        self._updated = now()
        self._lock = threading.RLock()

    def drive(self, width: float, *, speed: float, force: float) -> None:
        with self._lock:
            self.state()
            self._target, self._speed, self.force = width, speed, force

    def halt(self) -> None:
        with self._lock:
            self._target = self.state().width

    def state(self) -> JawsState:
        with self._lock:
            now = self._now()
            step = self._speed * (now - self._updated)
            self._updated = now
            narrowest, widest = self._span()
            goal = min(max(self._target, narrowest), widest)
            self._width += min(max(goal - self._width, -step), step)
            return JawsState(width=self._width, moving=self._width != goal)


class RobotiqModel:
    """Six command bytes in, six status bytes out. Safe to share between wires and threads.

    contact_latency: seconds from the echo of a request until gOBJ speaks about its motion; a
    gripper that is slow at this shows the end of the last motion meanwhile.
    """

    def __init__(
        self, jaws: Jaws, now: Callable[[], float], *, contact_latency: float = 0.0
    ) -> None:
        self._jaws = jaws
        self._now = now
        self.contact_latency = contact_latency
        self._lock = threading.RLock()
        self.powered = True
        self.activation_blocked = False  # gSTA stays at 1, as with jammed fingers
        self._restart()

    def _restart(self) -> None:
        self._command = [0, 0, 0]
        self._status_activation = 0
        self._journey: list[float] = []  # widths that activation still has to visit
        self._fault = FaultCode.NONE
        self._echo = self._contact = 0
        self._echo_at = self._contact_at = self._heard_at = self._now()

    # --- what a wire does ---------------------------------------------------------------------

    def write(self, address: int, words: Sequence[int]) -> None:
        """Raises LookupError outside the command registers."""
        with self._lock:
            offsets = _offsets(address, len(words), COMMAND)
            self.advance()
            was_active = self._rACT
            for offset, word in zip(offsets, words, strict=True):
                self._command[offset] = word
            self._obey(was_active)
            self._heard_at = self._now()

    def read(self, address: int, count: int) -> list[int]:
        """Raises LookupError outside the status and command registers."""
        with self._lock:
            self.advance()
            registers, span = (
                (self._command, COMMAND) if address in COMMAND else (self._status(), STATUS)
            )
            words = [registers[offset] for offset in _offsets(address, count, span)]
            self._heard_at = self._now()
            return words

    def advance(self) -> None:
        """Let what was under way happen up to now. Called every few milliseconds."""
        with self._lock:
            now = self._now()
            moving = self._jaws.state().moving
            if self._fault is FaultCode.RELEASING and not moving:
                self._fault = FaultCode.RELEASED
            if self._status_activation == 1 and not moving and not self.activation_blocked:
                self._proceed()
            if now >= self._echo_at:
                self._echo = self._rPR
            if now >= self._contact_at:
                self._contact = self._sense()

    # --- what may happen to it ----------------------------------------------------------------

    def fail(self, fault: FaultCode) -> None:
        """Raise a fault from A to F, or overheating; the fingers stop."""
        with self._lock:
            self._fault = fault
            self._journey = []
            self._jaws.halt()

    def cool_down(self) -> None:
        with self._lock:
            if self._fault is FaultCode.HOT:
                self._fault = FaultCode.NONE

    def release_automatically(self) -> None:
        """As after an emergency stop with rATR: opens slowly, then waits for a new activation."""
        with self._lock:
            self._fault = FaultCode.RELEASING
            self._jaws.drive(STROKE, speed=SLOWEST, force=WEAKEST)

    def cut_power(self) -> None:
        """Silent until `restore_power`; then neither active nor aware of what was asked."""
        with self._lock:
            self.powered = False
            self._jaws.halt()

    def restore_power(self) -> None:
        with self._lock:
            self._restart()
            self.powered = True

    # --- inside -------------------------------------------------------------------------------

    @property
    def _rACT(self) -> bool:
        return bool(self._command[0] >> 8 & 1)

    @property
    def _rGTO(self) -> bool:
        return bool(self._command[0] >> 11 & 1)

    @property
    def _rPR(self) -> int:
        return self._command[1] & 0xFF

    def _obey(self, was_active: bool) -> None:
        """Act on the command registers, which have just been written."""
        if self._command[0] >> 12 & 1:  # rATR
            self.release_automatically()
        elif not self._rACT:
            self._status_activation = 0
            self._journey = []
            if self._fault is not FaultCode.RELEASING:
                self._jaws.halt()
                self._fault = FaultCode.INACTIVE if self._rGTO else FaultCode.NONE
        elif not was_active:
            self._fault = FaultCode.NONE
            self._status_activation = 1
            self._journey = [0.0, STROKE]  # closes and opens fully to find its ends
            self._drive(self._journey[0], 255, 0)
        elif self._status_activation == 1:
            self._fault = FaultCode.DELAYED if self._rGTO else FaultCode.NONE
        else:
            self._set_off()
        self._echo_at = self._now() + ECHO_LATENCY
        self._contact_at = self._echo_at + self.contact_latency

    def _proceed(self) -> None:
        """The next leg of the activation, or its end."""
        self._journey = self._journey[1:]
        if self._journey:
            self._drive(self._journey[0], 255, 0)
            return
        self._status_activation = 3
        if self._fault is FaultCode.DELAYED:
            self._fault = FaultCode.NONE
        self._set_off()

    def _set_off(self) -> None:
        if self._fault is not FaultCode.NONE:
            return
        if self._rGTO:
            self._drive(_width(self._rPR), self._command[2] >> 8, self._command[2] & 0xFF)
        else:
            self._jaws.halt()

    def _drive(self, width: float, speed: int, force: int) -> None:
        self._jaws.drive(
            width,
            speed=SLOWEST + (FASTEST - SLOWEST) * speed / 255,
            force=WEAKEST + (STRONGEST - WEAKEST) * force / 255,
        )

    def _sense(self) -> int:
        """gOBJ: 0 under way, 1 blocked opening, 2 blocked closing, 3 at the request."""
        state = self._jaws.state()
        if state.moving:
            return 0
        lacking = _width(self._rPR) - state.width
        if not self._rGTO or abs(lacking) < 0.001:
            return 3
        return 1 if lacking > 0 else 2

    def _status(self) -> list[int]:
        fault = self._fault
        if fault is FaultCode.NONE and self._now() - self._heard_at > SILENCE_LIMIT:
            fault = FaultCode.SILENCE
        state = self._jaws.state()
        action = (
            self._rACT
            | self._rGTO << 3
            | self._status_activation << 4
            | (self._contact << 6 if self._status_activation == 3 else 0)
        )
        position = round(CLOSED_COUNTS - state.width / STROKE * (CLOSED_COUNTS - OPEN_COUNTS))
        current = 30 if state.moving else 0
        return [action << 8, fault << 8 | self._echo, position << 8 | current]


def _width(counts: int) -> float:
    """Metres for a position request; requests beyond the ends stop at the ends."""
    share = (CLOSED_COUNTS - counts) / (CLOSED_COUNTS - OPEN_COUNTS)
    return min(max(share, 0.0), 1.0) * STROKE


def _offsets(address: int, count: int, registers: range) -> range:
    if address not in registers or not 1 <= count <= registers.stop - address:
        raise LookupError(f"no registers {address} x {count}")
    return range(address - registers.start, address - registers.start + count)
