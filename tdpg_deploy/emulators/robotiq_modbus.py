"""Modbus RTU as a slave sees it: request bytes in, answer bytes out. Pure.

Modbus over Serial Line v1.02 and Modbus Application Protocol v1.1b3.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Protocol

READ_HOLDING, READ_INPUT, WRITE_ONE, WRITE, READ_WRITE = 0x03, 0x04, 0x06, 0x10, 0x17
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS = 1, 2


class Registers(Protocol):
    """Both raise LookupError for registers that do not exist."""

    def read(self, address: int, count: int) -> list[int]: ...

    def write(self, address: int, words: list[int]) -> None: ...


@dataclass(frozen=True, kw_only=True)
class Request:
    unit: int
    function: int
    data: bytes


def crc16(data: bytes) -> bytes:
    """Two bytes, low first (Modbus over Serial Line, 6.2.2)."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return struct.pack("<H", crc)


def frame(unit: int, function: int, data: bytes) -> bytes:
    body = bytes((unit, function)) + data
    return body + crc16(body)


def split_request(received: bytes) -> tuple[Request | None, bytes]:
    """The first request in `received`, if whole, and what remains.

    What does not check is dropped to the end, as a slave does that waits for the next pause.
    """
    length = _length(received)
    if length is None or len(received) < length:
        return None, received
    body, crc = received[: length - 2], received[length - 2 : length]
    if crc16(body) != crc:
        return None, b""
    return Request(unit=body[0], function=body[1], data=body[2:]), received[length:]


def answer(request: Request, registers: Registers) -> bytes:
    """The whole answer frame to a request that is addressed to us."""
    try:
        data = _perform(request.function, request.data, registers)
    except LookupError:
        return frame(request.unit, request.function | 0x80, bytes([ILLEGAL_ADDRESS]))
    if data is None:
        return frame(request.unit, request.function | 0x80, bytes([ILLEGAL_FUNCTION]))
    return frame(request.unit, request.function, data)


def _length(received: bytes) -> int | None:
    """Bytes of the request that begins here; None while its length cannot be known."""
    if len(received) < 2:
        return None
    counted_at = {WRITE: 6, READ_WRITE: 10}.get(received[1])
    if counted_at is None:
        return 8
    return counted_at + 1 + received[counted_at] + 2 if len(received) > counted_at else None


def _perform(function: int, data: bytes, registers: Registers) -> bytes | None:
    """The answer's data; None for a function that a 2F-85 does not know."""
    if function in (READ_HOLDING, READ_INPUT):
        return _counted(registers.read(*struct.unpack(">HH", data)))
    if function == WRITE_ONE:
        address, word = struct.unpack(">HH", data)
        registers.write(address, [word])
        return data
    if function == WRITE:
        (address,) = struct.unpack_from(">H", data)
        registers.write(address, _words(data[5:]))
        return data[:4]
    if function == READ_WRITE:
        read_address, read_count, write_address = struct.unpack_from(">HHH", data)
        registers.write(write_address, _words(data[9:]))
        return _counted(registers.read(read_address, read_count))
    return None


def _words(data: bytes) -> list[int]:
    return list(struct.unpack(f">{len(data) // 2}H", data[: len(data) // 2 * 2]))


def _counted(words: list[int]) -> bytes:
    return bytes([2 * len(words)]) + struct.pack(f">{len(words)}H", *words)
