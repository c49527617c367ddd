"""A Robotiq 2F-85 behind any wire: `hal.Gripper`, with the behaviour written once."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Protocol

from tdpg_deploy.cell_config import GripperSection
from tdpg_deploy.drivers.robotiq_registers import (
    Activation,
    Command,
    Contact,
    CountScale,
    Fault,
    Status,
    force_counts,
    speed_counts,
)
from tdpg_deploy.drivers.robotiq_rtu import TUNNEL_PORT, rtu_over_tcp_wire, serial_wire
from tdpg_deploy.drivers.robotiq_urcap import URCAP_PORT, UrcapWire
from tdpg_deploy.errors import DeviceError, DeviceTimeout, GripperError
from tdpg_deploy.hal import Clock, GripperState, Holding

POLL = 0.010  # s; the gripper renews its registers at 200 Hz (manual, 4.3)
CONTACT_LAG = 0.060  # s; gOBJ may show the last motion's end this long after gPR has echoed


def robotiq_gripper(section: GripperSection, *, arm_host: str, clock: Clock) -> RobotiqGripper:
    """The gripper of a cell file, on its wire. Opens nothing."""
    scale = CountScale(open_counts=section.open_counts, closed_counts=section.closed_counts)
    return RobotiqGripper(_wire(section, section.host or arm_host), clock=clock, scale=scale)


def _wire(section: GripperSection, host: str) -> RobotiqWire:
    if section.driver == "robotiq_rtu":
        assert section.port is not None  # the section has validated it
        return serial_wire(section.port, unit_id=section.unit_id)
    if section.driver == "robotiq_rtu_tcp":
        port = section.tcp_port or TUNNEL_PORT
        return rtu_over_tcp_wire(host, port=port, unit_id=section.unit_id)
    return UrcapWire(host, port=section.tcp_port or URCAP_PORT)


class RobotiqWire(Protocol):
    """Carries registers. Each call is bounded, and raises DeviceError when it fails."""

    @property
    def name(self) -> str:
        """What a person would look for: "gripper on /dev/ttyUSB0"."""

    def open(self) -> None: ...

    def close(self) -> None: ...

    def write(self, command: Command) -> None: ...

    def read(self) -> Status:
        """Status, sampled after the call began."""


class RobotiqGripper:
    """`hal.Gripper` on a wire. Widths follow `scale`: calibrate its counts per gripper.

    Deadlines are the clock's; the patience of a wire that fails (a second or two of real time)
    comes on top. After any failure of a motion the fingers are told to stop.
    """

    def __init__(self, wire: RobotiqWire, *, clock: Clock, scale: CountScale | None = None) -> None:
        self._wire = wire
        self._clock = clock
        self._scale = scale or CountScale()

    @property
    def name(self) -> str:
        """Of the wire: where the gripper is looked for."""
        return self._wire.name

    @property
    def max_width(self) -> float:
        return self._scale.max_width

    def connect(self) -> None:
        """Open the wire and hear the gripper answer. Nothing moves."""
        self._wire.open()
        try:
            self._wire.read()
        except DeviceError:
            self._wire.close()
            raise

    def close(self) -> None:
        """Release the wire. The fingers keep their grip: the gripper holds by itself."""
        self._wire.close()

    def status(self) -> Status:
        """The registers as they are, faults included (for diagnosis)."""
        return self._wire.read()

    def state(self) -> GripperState:
        """Raises GripperError on a fault after which the fingers hold nothing."""
        status = self._wire.read()
        if status.fault.is_major:
            raise self._fault(status)
        return self._measured(status)

    def activate(self, *, deadline: float = 10.0) -> None:
        end = self._clock.now() + deadline
        status = self._wire.read()
        if status.is_ready and not status.fault.is_major:
            return
        # While it releases by itself the gripper takes no activation.
        self._wait(end, lambda s: s.fault is not Fault.AUTOMATIC_RELEASE, "release")
        try:
            # Major faults and a half-done activation are cleared by a rising edge of rACT only.
            self._wire.write(Command(activate=False))
            self._wait(end, lambda s: s.activation is Activation.RESET, "reset")
            self._wire.write(Command(activate=True))
            status = self._wait(end, lambda s: s.is_ready or s.fault.is_major, "activate")
            if status.fault.is_major:
                raise self._fault(status)
        except BaseException:
            self._give_up_activation()
            raise

    def move(
        self, width: float, *, speed: float, force: float, deadline: float = 5.0
    ) -> GripperState:
        """Raises GripperError on a fault or without activation, DeviceTimeout after `deadline`."""
        end = self._clock.now() + deadline
        self._require_able(self._wire.read())
        request = Command(
            activate=True,
            go_to=True,
            position=self._scale.counts(width),
            speed=speed_counts(speed),
            force=force_counts(force),
        )
        try:
            self._wire.write(request)
            return self._measured(self._await_end(request.position, end))
        except BaseException:
            self._halt()
            raise

    def _await_end(self, position: int, end: float) -> Status:
        """Status once the motion to `position` (counts) is over."""
        echoed_at: float | None = None
        while True:
            status = self._wire.read()
            self._require_able(status)
            now = self._clock.now()
            if status.echo != position:
                echoed_at = None
            elif echoed_at is None:
                echoed_at = now
            elif status.contact is not Contact.MOVING and now - echoed_at >= CONTACT_LAG:
                return status
            if now >= end:
                raise DeviceTimeout(
                    f"{self._wire.name}: still {status.contact.name.lower()} at "
                    f"{self._scale.width(status.position) * 1e3:.1f} mm on the way to "
                    f"{self._scale.width(position) * 1e3:.1f} mm (gPR {status.echo}, asked "
                    f"{position}) at the deadline; stopped. Allow more time or speed"
                )
            self._clock.sleep(POLL)

    def _wait(self, end: float, until: Callable[[Status], bool], what: str) -> Status:
        while not until(status := self._wire.read()):
            if self._clock.now() >= end:
                raise DeviceTimeout(
                    f"{self._wire.name}: did not {what} before the deadline "
                    f"(gSTA {status.activation.name}, fault {status.fault.name}: "
                    f"{status.fault.remedy}); free the fingers, check the 24 V supply"
                )
            self._clock.sleep(POLL)
        return status

    def _require_able(self, status: Status) -> None:
        if status.fault.is_major or status.fault is Fault.OVERHEATED:
            raise self._fault(status)
        if not status.is_ready:
            raise GripperError(
                f"{self._wire.name}: not activated (gSTA {status.activation.name}, fault "
                f"{status.fault.name}): it was never activated, or lost power since; "
                "clear the fingers and activate it"
            )

    def _fault(self, status: Status) -> GripperError:
        fault = status.fault
        return GripperError(f"{self._wire.name}: fault 0x{fault:02X} {fault.name}: {fault.remedy}")

    def _halt(self) -> None:
        """Stop a motion that failed."""
        with contextlib.suppress(DeviceError):  # the caller hears of the first failure
            self._wire.open()
            # rACT written to a gripper that has just lost its activation would start the
            # activation: the fingers would travel.
            if self._wire.read().is_ready:
                self._wire.write(Command(activate=True))

    def _give_up_activation(self) -> None:
        with contextlib.suppress(DeviceError):
            self._wire.open()
            self._wire.write(Command(activate=False))

    def _measured(self, status: Status) -> GripperState:
        return GripperState(
            width=self._scale.width(status.position),
            moving=status.is_ready and status.going and status.contact is Contact.MOVING,
            holding=_holding(status),
            stamp=self._clock.now(),
        )


def _holding(status: Status) -> Holding:
    """A contact while opening is not a grasp between the pads: the gripper cannot tell."""
    if not status.is_ready or not status.going:
        return Holding.UNKNOWN
    return {
        Contact.WHILE_CLOSING: Holding.OBJECT,
        Contact.AT_REQUEST: Holding.NOTHING,
    }.get(status.contact, Holding.UNKNOWN)
