"""The text protocol of the Robotiq URCap: request lines in, reply bytes out. Pure."""

from __future__ import annotations

from tdpg_deploy.emulators.robotiq import COMMAND
from tdpg_deploy.emulators.robotiq_modbus import Registers

ACKNOWLEDGED, REFUSED = b"ack", b"?"

# variable -> (register, lowest bit, width in bits)
SETTABLE = {
    "ACT": (1000, 8, 1),
    "GTO": (1000, 11, 1),
    "ATR": (1000, 12, 1),
    "ADR": (1000, 13, 1),
    "POS": (1001, 0, 8),
    "SPE": (1002, 8, 8),
    "FOR": (1002, 0, 8),
}
READABLE = SETTABLE | {
    "STA": (2000, 12, 2),
    "OBJ": (2000, 14, 2),
    "FLT": (2001, 8, 8),
    "PRE": (2001, 0, 8),
    "POS": (2002, 8, 8),
}


def reply_to(line: str, registers: Registers) -> bytes:
    """`GET POS` -> `POS 228\\n`; `SET POS 255 GTO 1` -> `ack`; anything else -> `?`."""
    verb, *words = line.split()[:32] or [""]
    if verb == "GET" and len(words) == 1 and words[0] in READABLE:
        return f"{words[0]} {_get(words[0], registers)}\n".encode("ascii")
    if verb == "SET" and words and _set(words, registers):
        return ACKNOWLEDGED
    return REFUSED


def _get(variable: str, registers: Registers) -> int:
    address, shift, bits = READABLE[variable]
    (word,) = registers.read(address, 1)
    return word >> shift & (1 << bits) - 1


def _set(words: list[str], registers: Registers) -> bool:
    command = registers.read(COMMAND.start, len(COMMAND))
    for variable, number in zip(words[::2], [*words[1::2], ""], strict=False):
        if variable not in SETTABLE or not number.isdecimal():
            return False
        address, shift, bits = SETTABLE[variable]
        if int(number) >= 1 << bits:
            return False
        mask = (1 << bits) - 1 << shift
        offset = address - COMMAND.start
        command[offset] = command[offset] & ~mask | int(number) << shift
    registers.write(COMMAND.start, command)
    return True
