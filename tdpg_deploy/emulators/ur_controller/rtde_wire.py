"""RTDE protocol version 2 as a controller sees it: bytes to requests, replies to bytes. Pure.

A package is a u16 size (header included), a u8 type and a payload, all big endian.
Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import TypeAlias

HEADER = struct.Struct(">HB")
PROTOCOL_VERSION = 2

Value: TypeAlias = "int | float | Sequence[int] | Sequence[float]"


class WireError(ValueError):
    """Bytes that no RTDE client would send."""


class Kind(IntEnum):
    """Package types: ASCII letters."""

    REQUEST_PROTOCOL_VERSION = ord("V")
    GET_CONTROLLER_VERSION = ord("v")
    TEXT_MESSAGE = ord("M")
    DATA = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


class FieldType(Enum):
    """Types of variables, with their `struct` formats."""

    UINT32 = "I"
    UINT64 = "Q"
    INT32 = "i"
    DOUBLE = "d"
    VECTOR3D = "3d"
    VECTOR6D = "6d"
    VECTOR6INT32 = "6i"


@dataclass(frozen=True, kw_only=True)
class Package:
    """One package as it came; `kind` may be a number that no guide lists."""

    kind: int
    payload: bytes

    def encode(self) -> bytes:
        return HEADER.pack(HEADER.size + len(self.payload), self.kind) + self.payload


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """The variables of a data package, in order. `id` 0 is a recipe that was refused."""

    id: int
    names: tuple[str, ...]
    types: tuple[FieldType, ...]

    @property
    def _struct(self) -> struct.Struct:
        return struct.Struct(">B" + "".join(kind.value for kind in self.types))

    def pack(self, values: Sequence[Value]) -> bytes:
        """A data package that holds one value a variable."""
        flat: list[float] = []
        for value in values:
            if isinstance(value, (int, float)):
                flat.append(value)
            else:
                flat.extend(value)
        return Package(kind=Kind.DATA, payload=self._struct.pack(self.id, *flat)).encode()

    def unpack(self, payload: bytes) -> dict[str, Value]:
        """Values by name. Raises WireError when the payload has another length."""
        if len(payload) != self._struct.size:
            raise WireError(f"recipe {self.id} takes {self._struct.size} bytes, got {len(payload)}")
        flat = list(self._struct.unpack(payload)[1:])
        values: dict[str, Value] = {}
        for name, kind in zip(self.names, self.types, strict=True):
            count = int(kind.value[:-1] or 1)
            values[name] = flat[0] if count == 1 else flat[:count]
            del flat[:count]
        return values


def split(buffer: bytes) -> tuple[list[Package], bytes]:
    """The whole packages at the start of `buffer`, and the bytes that are left."""
    found = []
    while len(buffer) >= HEADER.size:
        size, kind = HEADER.unpack_from(buffer)
        if size < HEADER.size:
            raise WireError(f"a package of {size} bytes is shorter than its header")
        if len(buffer) < size:
            break
        found.append(Package(kind=kind, payload=buffer[HEADER.size : size]))
        buffer = buffer[size:]
    return found, buffer


def parse_names(payload: bytes) -> tuple[str, ...]:
    """Comma-separated names; a comma may follow the last (ur_rtde writes one)."""
    try:
        text = payload.decode("ascii")
    except UnicodeDecodeError as error:
        raise WireError(f"variable names are not ASCII: {payload!r}") from error
    return tuple(name for name in text.split(",") if name)


def parse_output_setup(payload: bytes) -> tuple[float, tuple[str, ...]]:
    """Rate in Hz, and the names asked for."""
    if len(payload) < 8:
        raise WireError(f"an output setup starts with eight bytes of rate, got {payload!r}")
    return struct.unpack_from(">d", payload)[0], parse_names(payload[8:])


def accepted(kind: Kind, *, ok: bool = True) -> bytes:
    """The answer of one byte to a protocol version request, start or pause."""
    return Package(kind=kind, payload=bytes([ok])).encode()


def controller_version(version: tuple[int, int, int, int]) -> bytes:
    return Package(kind=Kind.GET_CONTROLLER_VERSION, payload=struct.pack(">4I", *version)).encode()


def recipe_reply(kind: Kind, recipe_id: int, types: Sequence[str]) -> bytes:
    """`types` are FieldType names, or NOT_FOUND or IN_USE for what is refused."""
    payload = bytes([recipe_id]) + ",".join(types).encode("ascii")
    return Package(kind=kind, payload=payload).encode()
