"""Robotiq registers over the text socket of the gripper's URCap on a UR controller."""

from __future__ import annotations

import socket
import time

from tdpg_deploy.drivers.robotiq_registers import (
    Activation,
    Command,
    Contact,
    Fault,
    Status,
)
from tdpg_deploy.errors import DeviceTimeout, DeviceUnreachable, GripperError

URCAP_PORT = 63352

CONNECT_TIMEOUT = 1.0  # s
ANSWER_TIMEOUT = 0.5  # s; the controller answers within a few milliseconds

ACKNOWLEDGED = "ack"
REFUSED = "?"


def encode_command(command: Command) -> bytes:
    """One SET of all variables, as the command registers hold them: no automatic release (ATR).
    ACT and GTO come last, so that a motion starts complete."""
    return (
        f"SET POS {command.position} SPE {command.speed} FOR {command.force} "
        f"ATR 0 ACT {command.activate:d} GTO {command.go_to:d}\n"
    ).encode("ascii")


def split_reply(received: bytes) -> tuple[str, bytes] | None:
    """The first whole reply in `received` and what follows it; None when it is incomplete.

    `ack` and `?` come without a newline, values with one.
    """
    text = received.lstrip(b"\r\n")
    for whole in (ACKNOWLEDGED, REFUSED):
        if text.startswith(whole.encode("ascii")):
            return whole, text[len(whole) :]
    line, newline, rest = text.partition(b"\n")
    return (line.decode("ascii", "replace").strip(), rest) if newline else None


def parse_value(variable: str, reply: str) -> int:
    """`POS 228` -> 228. Raises ValueError on another variable, or no number."""
    name, _, number = reply.partition(" ")
    if name != variable:
        raise ValueError(f"asked for {variable}, got {reply!r}")
    return int(number)


class UrcapWire:
    """A `RobotiqWire` through port 63352 of a UR controller."""

    def __init__(self, host: str, *, port: int = URCAP_PORT) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._received = b""

    @property
    def name(self) -> str:
        host, port = self._address
        return f"gripper at {host}:{port} (URCap)"

    def open(self) -> None:
        if self._socket is not None:
            return
        try:
            self._socket = socket.create_connection(self._address, CONNECT_TIMEOUT)
        except OSError as error:
            raise DeviceUnreachable(
                f"{self.name}: cannot connect ({error}); is the address right, the controller "
                "on, and the Robotiq URCap installed?"
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._received = b""

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def write(self, command: Command) -> None:
        reply = self._persist(encode_command(command))
        if reply != ACKNOWLEDGED:
            raise self._unexpected("SET", reply)

    def read(self) -> Status:
        # The echo first: a contact read after it belongs to the echoed request, or to a later.
        echo = self._get("PRE")
        contact = self._get("OBJ")
        position = self._get("POS")
        fault = self._get("FLT")
        activation = self._get("STA")
        activated, going = self._get("ACT"), self._get("GTO")
        try:
            return Status(
                activated=bool(activated),
                going=bool(going),
                activation=Activation(activation),
                contact=Contact(contact),
                fault=Fault(fault & 0x0F),
                echo=echo,
                position=position,
                current=None,
            )
        except ValueError as error:
            raise GripperError(f"{self.name}: not a 2F-85's status: {error}") from error

    def _get(self, variable: str) -> int:
        reply = self._persist(f"GET {variable}\n".encode("ascii"))
        try:
            return parse_value(variable, reply)
        except ValueError as error:
            raise self._unexpected(f"GET {variable}", reply) from error

    def _unexpected(self, request: str, reply: str) -> GripperError:
        self.close()  # whatever else is under way would be taken for the next reply
        return GripperError(
            f"{self.name}: answered {reply!r} to {request}; is the arm emergency-stopped, or "
            "the gripper not assigned in the URCap?"
        )

    def _persist(self, request: bytes) -> str:
        """Ask, and once more on a new connection: asking twice is harmless, and a late reply
        ends with the connection that it was late on."""
        if self._socket is None:
            raise DeviceUnreachable(f"{self.name}: not connected; call connect() first")
        try:
            return self._ask(self._socket, request)
        except OSError:
            self.close()
            self.open()
        try:
            return self._ask(self._socket, request)
        except TimeoutError as error:
            self.close()
            raise DeviceTimeout(
                f"{self.name}: no answer to {request.decode().strip()!r} within "
                f"{ANSWER_TIMEOUT} s, twice; is the URCap running?"
            ) from error
        except OSError as error:
            self.close()
            raise DeviceUnreachable(
                f"{self.name}: connection lost ({error}); is the controller on? Connect again"
            ) from error

    def _ask(self, connection: socket.socket, request: bytes) -> str:
        """Send one line and return its reply. Raises OSError."""
        end = time.monotonic() + ANSWER_TIMEOUT
        connection.settimeout(ANSWER_TIMEOUT)
        connection.sendall(request)
        while (split := split_reply(self._received)) is None:
            connection.settimeout(max(end - time.monotonic(), 1e-3))
            received = connection.recv(1024)
            if not received:
                raise ConnectionResetError("closed by the other end")
            self._received += received
        reply, self._received = split
        return reply
