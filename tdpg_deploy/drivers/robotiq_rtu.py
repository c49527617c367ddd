"""Robotiq registers over Modbus RTU: on a serial line, or tunnelled through TCP."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

from tdpg_deploy.drivers.robotiq_registers import (
    COMMAND_ADDRESS,
    STATUS_ADDRESS,
    WORDS,
    Command,
    Status,
    parse_status,
)
from tdpg_deploy.errors import DeviceTimeout, DeviceUnreachable

UNIT_ID = 9  # manual, 4.7: factory setting
BAUD_RATE = 115_200  # manual, 4.7
TUNNEL_PORT = 54321  # where a UR controller forwards its tool connector

ANSWER_TIMEOUT = 0.2  # s; an answer takes 5 ms, a USB converter may add 16 ms
ATTEMPTS = 3

T = TypeVar("T")


def serial_wire(port: str, *, unit_id: int = UNIT_ID) -> ModbusWire:
    """On a serial line, best named by /dev/serial/by-id."""

    def client() -> Any:
        from pymodbus.client import ModbusSerialClient

        return ModbusSerialClient(port, baudrate=BAUD_RATE, timeout=ANSWER_TIMEOUT, retries=0)

    return ModbusWire(
        client, name=f"gripper on {port}", unit_id=unit_id, hint=lambda: _why_closed(port)
    )


def rtu_over_tcp_wire(host: str, *, port: int = TUNNEL_PORT, unit_id: int = UNIT_ID) -> ModbusWire:
    """RTU frames through a TCP connection: a UR tool connector, or a serial device server."""

    def client() -> Any:
        from pymodbus import FramerType
        from pymodbus.client import ModbusTcpClient

        return ModbusTcpClient(
            host, port=port, framer=FramerType.RTU, timeout=ANSWER_TIMEOUT, retries=0
        )

    return ModbusWire(
        client,
        name=f"gripper at {host}:{port} (RTU over TCP)",
        unit_id=unit_id,
        hint=lambda: "is the address right, and does the port forward the serial line?",
    )


class ModbusWire:
    """A `RobotiqWire`. RTU frames carry no transaction number, so a late answer could pass for
    that to the next request: after a failure the line is opened anew and listened to until it
    is silent, before anything else is asked."""

    def __init__(
        self, client: Callable[[], Any], *, name: str, unit_id: int, hint: Callable[[], str]
    ) -> None:
        self._new_client = client
        self._client: Any = None
        self._doubtful = False  # an answer may still be under way
        self._name = name
        self._unit_id = unit_id
        self._hint = hint

    @property
    def name(self) -> str:
        return self._name

    def open(self) -> None:
        if self._client is None:
            try:
                client = self._new_client()
            except ImportError as error:
                raise DeviceUnreachable(
                    f"{self.name}: {error}: pip install 'tdpg-deploy[real]'"
                ) from error
            if not client.connect():
                raise DeviceUnreachable(f"{self.name}: cannot be opened: {self._hint()}")
            self._client = client

    def close(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def write(self, command: Command) -> None:
        def exchange() -> None:
            answer = self._client.write_registers(
                COMMAND_ADDRESS, list(command.registers()), device_id=self._unit_id
            )
            if answer.isError() or (answer.address, answer.count) != (COMMAND_ADDRESS, WORDS):
                raise ValueError(f"answered {answer}")

        self._persist(exchange)

    def read(self) -> Status:
        def exchange() -> Status:
            answer = self._client.read_input_registers(
                STATUS_ADDRESS, count=WORDS, device_id=self._unit_id
            )
            if answer.isError():
                raise ValueError(f"answered {answer}")
            return parse_status(answer.registers)

        return self._persist(exchange)

    def _persist(self, exchange: Callable[[], T]) -> T:
        """Repeat an exchange after silence or a damaged answer: writing twice is harmless."""
        from pymodbus.exceptions import ModbusException

        if self._client is None:
            raise DeviceUnreachable(f"{self.name}: not connected; call connect() first")
        problem: Exception | None = None
        for _ in range(ATTEMPTS):
            try:
                if self._doubtful:
                    self._start_afresh()
                return exchange()
            except (ModbusException, OSError, ValueError) as error:  # noqa: PERF203
                problem = error
                self._doubtful = True
        raise DeviceTimeout(
            f"{self.name}: no valid answer from unit {self._unit_id} in {ATTEMPTS} attempts "
            f"(last: {problem}); check its 24 V supply and unit id, and that no URCap owns the bus"
        )

    def _start_afresh(self) -> None:
        """Open the line anew and let late answers pass: at most as many as were provoked."""
        self.close()
        self.open()
        for _ in range(ATTEMPTS):
            if not self._client.recv(None):
                break
        self._doubtful = False


def _why_closed(port: str) -> str:
    if not os.path.exists(port):
        return "there is no such port; is it plugged in? /dev/serial/by-id lists what is"
    if not os.access(port, os.R_OK | os.W_OK):
        return "no permission; add yourself to the group that owns it (dialout)"
    return "held by another program, or not a serial port"
