"""First words with a UR controller, each answered before a deadline.

ur_rtde's constructors wait for ever on a peer that accepts and never answers, and its
messages do not tell a switched-off controller from a wrong address. So this asks first.
"""

from __future__ import annotations

import re
import socket
import struct
import time
from types import TracebackType

from tdpg_deploy.drivers.ur5_status import ControllerVersion, RobotMode, SafetyMode
from tdpg_deploy.errors import ArmError, DeviceTimeout, DeviceUnreachable

DASHBOARD_PORT = 29999
SCRIPT_PORT = 30003
RTDE_PORT = 30004
_RTDE_HEADER = 3  # bytes: u16 size of the package, u8 kind (RTDE guide, "Header")
_RTDE_TEXT = b"M"


class Connection:
    """A TCP connection that raises DeviceError instead of waiting past `deadline` seconds."""

    def __init__(self, host: str, port: int, *, deadline: float) -> None:
        self._name = f"the UR controller at {host}:{port}"
        self._end = time.monotonic() + deadline
        self._buffer = b""
        try:
            self._socket = socket.create_connection((host, port), timeout=deadline)
        except TimeoutError as error:
            raise DeviceTimeout(
                f"{self._name} did not answer within {deadline:.1f} s: is it switched on, is the "
                "cable in, is arm.host right?"
            ) from error
        except OSError as error:
            raise DeviceUnreachable(
                f"{self._name} cannot be reached ({error.strerror}): is it switched on and booted, "
                "is arm.host right?"
            ) from error

    def __enter__(self) -> Connection:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._socket.close()

    def send(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise self._lost(error) from error

    def line(self) -> str:
        """Up to the next newline."""
        while b"\n" not in self._buffer:
            self._buffer += self._receive()
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line.decode("utf-8", "replace").strip()

    def exactly(self, count: int) -> bytes:
        while len(self._buffer) < count:
            self._buffer += self._receive()
        data, self._buffer = self._buffer[:count], self._buffer[count:]
        return data

    def nonsense(self, data: bytes) -> DeviceUnreachable:
        return DeviceUnreachable(
            f"{self._name} answers {data[:20]!r}, which no UR controller would: is arm.host right?"
        )

    def _receive(self) -> bytes:
        try:
            self._socket.settimeout(max(self._end - time.monotonic(), 1e-3))
            data = self._socket.recv(4096)
        except TimeoutError as error:
            raise DeviceTimeout(
                f"{self._name} accepts connections and does not answer: it is booting or hangs; "
                "wait a minute, else restart it"
            ) from error
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost(None)
        return data

    def _lost(self, error: OSError | None) -> DeviceUnreachable:
        why = error.strerror if error else "closed by the controller"
        return DeviceUnreachable(f"the connection to {self._name} was lost ({why})")


def ask_dashboard(host: str, *commands: str, deadline: float = 2.0) -> list[str]:
    """The dashboard server's reply to each command. Raises DeviceError."""
    with Connection(host, DASHBOARD_PORT, deadline=deadline) as connection:
        connection.line()  # greeting
        replies = []
        for command in commands:
            connection.send(f"{command}\n".encode())
            replies.append(connection.line())
        return replies


def ask_version(host: str, *, deadline: float = 2.0) -> ControllerVersion:
    """By RTDE: protocol version 2 ("V"), then the controller's version ("v")."""
    with Connection(host, RTDE_PORT, deadline=deadline) as connection:
        if rtde_request(connection, b"V", struct.pack(">H", 2)) != b"\1":
            raise ArmError(
                f"the controller at {host} does not speak version 2 of RTDE: update PolyScope to "
                "3.4 or newer"
            )
        payload = rtde_request(connection, b"v")
        if len(payload) != struct.calcsize(">4I"):
            raise connection.nonsense(payload)
        major, minor, bugfix, build = struct.unpack(">4I", payload)
        return ControllerVersion(major=major, minor=minor, bugfix=bugfix, build=build)


def rtde_request(connection: Connection, kind: bytes, payload: bytes = b"") -> bytes:
    """The payload of the answer, which is of the same kind."""
    connection.send(struct.pack(">Hc", _RTDE_HEADER + len(payload), kind) + payload)
    return rtde_payload(connection, kind)


def rtde_payload(connection: Connection, kind: bytes) -> bytes:
    """Of the next package of this kind; text messages may come before it. Raises DeviceError,
    DeviceUnreachable for bytes that no controller would send."""
    while True:
        header = connection.exactly(_RTDE_HEADER)
        size, got = struct.unpack(">Hc", header)
        if size < _RTDE_HEADER or got not in (kind, _RTDE_TEXT):
            raise connection.nonsense(header)
        payload = connection.exactly(size - _RTDE_HEADER)
        if got == kind:
            return payload


def ask_modes(host: str) -> tuple[int, int]:
    """Robot mode and safety mode, as the dashboard tells them."""
    robot, safety = ask_dashboard(host, "robotmode", "safetymode")
    return (
        _number(RobotMode, robot, RobotMode.NO_CONTROLLER),
        _number(SafetyMode, safety, SafetyMode.UNDEFINED),
    )


def ask_remote_control(host: str) -> bool:
    return ask_dashboard(host, "is in remote control")[0].lower() == "true"


def ask_model(host: str, version: ControllerVersion) -> str | None:
    """As "UR5e": the dashboard tells the size, the software the series. None from a controller
    that does not know the question, older than 3.12, or 5.6."""
    reply = ask_dashboard(host, "get robot model")[0]
    size = re.match(r"UR\d+", reply)
    return size[0] + ("e" if version.major >= 5 else "") if size else None


def check_script_port(host: str, *, deadline: float = 2.0) -> None:
    """Raises DeviceError when no program could be uploaded."""
    Connection(host, SCRIPT_PORT, deadline=deadline).__exit__(None, None, None)


def _number(
    modes: type[RobotMode] | type[SafetyMode], reply: str, unknown: RobotMode | SafetyMode
) -> int:
    """Of a reply such as `Robotmode: RUNNING`."""
    name = reply.rpartition(":")[2].strip().upper()
    return modes[name] if name in modes.__members__ else unknown
