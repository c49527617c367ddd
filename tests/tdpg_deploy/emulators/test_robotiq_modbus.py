"""RTU frames against the manual's printed examples and two other implementations."""

from __future__ import annotations

import minimalmodbus
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU

from tdpg_deploy.emulators.robotiq_modbus import Request, answer, crc16, frame, split_request


class Memory:
    """Registers 1000 to 1002 and 2000 to 2002, without a gripper."""

    def __init__(self, *status: int) -> None:
        self.words = dict(zip(range(1000, 1003), (0, 0, 0), strict=True))
        self.words |= dict(zip(range(2000, 2003), status or (0, 0, 0), strict=True))

    def read(self, address: int, count: int) -> list[int]:
        return [self.words[a] for a in range(address, address + count)]

    def write(self, address: int, words: list[int]) -> None:
        for offset, word in enumerate(words):
            self.words[address + offset] = word


def exchange(request: str, memory: Memory) -> str:
    parsed, rest = split_request(bytes.fromhex(request))
    assert parsed is not None
    assert rest == b""
    return answer(parsed, memory).hex().upper()


def test_the_manuals_write_of_a_motion() -> None:
    memory = Memory()
    # Answer: the manual's pattern (address and count echoed), its CRC by pymodbus.
    assert exchange("091003E800030609000000FFFF7219", memory) == "091003E8000301 30".replace(
        " ", ""
    )
    assert memory.read(1000, 3) == [0x0900, 0x0000, 0xFFFF]


@pytest.mark.parametrize(
    ("status", "printed"),
    [
        ((0xF900, 0x0000, 0x0D00), "090406F90000000D0017AA"),
        ((0xB900, 0x00FF, 0xBD00), "090406B90000FFBD005C9A"),
    ],
)
def test_the_manuals_reads_of_status(status: tuple[int, ...], printed: str) -> None:
    assert exchange("090407D00003B1CE", Memory(*status)) == printed


@given(st.binary(max_size=64))
def test_the_checksum_agrees_with_other_implementations(data: bytes) -> None:
    assert crc16(data) == FramerRTU.compute_CRC(data).to_bytes(2, "big")
    assert crc16(data) == minimalmodbus._calculate_crc(data)


@given(st.binary(max_size=64), st.integers(0, 64))
def test_whatever_arrives_nothing_breaks(data: bytes, cut: int) -> None:
    received = b""
    for part in (data[:cut], data[cut:]):
        request, received = split_request(received + part)
        if request is not None:
            answer(request, Memory())


requests = st.one_of(
    st.tuples(st.sampled_from((3, 4, 6)), st.binary(min_size=4, max_size=4)),
    st.tuples(
        st.just(16), st.binary(max_size=20).map(lambda d: b"\3\xe8\0\0" + bytes([len(d)]) + d)
    ),
    st.tuples(
        st.just(23),
        st.binary(max_size=20).map(lambda d: b"\7\xd0\0\3\3\xe8\0\0" + bytes([len(d)]) + d),
    ),
)


@given(st.lists(requests, min_size=1, max_size=4), st.data())
def test_requests_survive_any_cutting_of_the_stream(
    asked: list[tuple[int, bytes]], data: st.DataObject
) -> None:
    stream = b"".join(frame(9, function, body) for function, body in asked)
    got, received = [], b""
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        received, stream = received + stream[:cut], stream[cut:]
        while True:
            request, received = split_request(received)
            if request is None:
                break
            got.append((request.function, request.data))
    assert got == asked


def test_a_damaged_request_gets_no_answer() -> None:
    assert split_request(bytes.fromhex("090407D00003B1CF")) == (None, b"")


@pytest.mark.parametrize(
    ("function", "data", "code"),
    [(4, "07D00004", 2), (3, "00000001", 2), (16, "07D1000102FFFF", None), (43, "0E010000", 1)],
)
def test_refusals_carry_the_standards_exception_codes(
    function: int, data: str, code: int | None
) -> None:
    request = Request(unit=9, function=function, data=bytes.fromhex(data))
    reply = answer(request, Memory())
    expected = frame(9, function | 0x80, bytes([code])) if code else reply
    assert reply == expected


def test_write_one_and_read_write() -> None:
    memory = Memory(1, 2, 3)
    one = answer(Request(unit=9, function=6, data=bytes.fromhex("03E80100")), memory)
    assert one == frame(9, 6, bytes.fromhex("03E80100"))
    both = Request(unit=9, function=23, data=bytes.fromhex("07D0000303E90001020055"))
    assert answer(both, memory) == frame(9, 23, bytes.fromhex("06000100020003"))
    assert memory.read(1000, 2) == [0x0100, 0x0055]
