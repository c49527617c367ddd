"""Listens to a UR controller's states for a moment, and writes nothing to it.

Real-Time Data Exchange (RTDE) Guide, protocol version 2: u16 size, u8 kind, payload.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise

from tdpg_deploy.drivers.ur5_network import (
    RTDE_PORT,
    Connection,
    rtde_payload,
    rtde_request,
)
from tdpg_deploy.errors import DeviceUnreachable

VARIABLES = "timestamp,actual_q,target_speed_fraction"
TYPES = b"DOUBLE,VECTOR6D,DOUBLE"
SAMPLES = 100
DEADLINE = 5.0  # s


@dataclass(frozen=True, kw_only=True)
class Listening:
    """rate: states a second, by the controller's own clock. longest_gap: s between two.
    q: (6,) rad. slider: the operator's share of the speed."""

    rate: float
    longest_gap: float
    q: tuple[float, ...]
    slider: float


def listen(host: str, *, rate: float) -> Listening:
    """Ask for `rate` states a second and hear SAMPLES of them. Raises DeviceError."""
    with Connection(host, RTDE_PORT, deadline=DEADLINE) as connection:
        rtde_request(connection, b"V", struct.pack(">H", 2))
        reply = rtde_request(connection, b"O", struct.pack(">d", rate) + VARIABLES.encode())
        if reply[1:] != TYPES:
            raise DeviceUnreachable(
                f"the controller at {host} offers {reply[1:].decode()} for {VARIABLES}: is it "
                "PolyScope 3.4 or newer?"
            )
        rtde_request(connection, b"S")
        states = [_state(rtde_payload(connection, b"U")) for _ in range(SAMPLES)]
    stamps = [stamp for stamp, _, _ in states]
    gaps = [after - before for before, after in pairwise(stamps)]
    _, q, slider = states[-1]
    return Listening(
        rate=len(gaps) / max(stamps[-1] - stamps[0], 1e-9),
        longest_gap=max(gaps),
        q=q,
        slider=slider,
    )


def _state(payload: bytes) -> tuple[float, tuple[float, ...], float]:
    stamp, *q, slider = struct.unpack_from(">8d", payload, 1)
    return stamp, tuple(q), slider
