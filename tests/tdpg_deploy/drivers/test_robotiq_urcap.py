"""The URCap's text protocol: bytes, and a server that misbehaves."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotiq_on_wires import Bench, emulated_gripper

from tdpg_deploy.drivers.robotiq_registers import Command
from tdpg_deploy.drivers.robotiq_urcap import UrcapWire, encode_command, parse_value, split_reply
from tdpg_deploy.emulators.robotiq_wires import first, late, mute
from tdpg_deploy.errors import DeviceTimeout, DeviceUnreachable, GripperError


def test_a_motion_is_one_line() -> None:
    command = Command(activate=True, go_to=True, position=255, speed=254, force=100)
    assert encode_command(command) == b"SET POS 255 SPE 254 FOR 100 ATR 0 ACT 1 GTO 1\n"


replies = st.one_of(
    st.sampled_from(["ack", "?"]),
    st.tuples(st.sampled_from(["POS", "OBJ", "ACT"]), st.integers(0, 255)).map(
        lambda pair: f"{pair[0]} {pair[1]}"
    ),
)


@given(st.lists(replies, min_size=1), st.data())
def test_replies_survive_any_cutting_of_the_stream(sent: list[str], data: st.DataObject) -> None:
    stream = b"".join(text.encode() + (b"" if text in ("ack", "?") else b"\n") for text in sent)
    got, received = [], b""
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        received, stream = received + stream[:cut], stream[cut:]
        while (split := split_reply(received)) is not None:
            reply, received = split
            got.append(reply)
    assert got == sent


@given(st.binary(max_size=40))
def test_any_bytes_are_a_reply_or_none(received: bytes) -> None:
    split = split_reply(received)
    if split is not None:
        assert len(split[1]) < len(received)


def test_a_value_names_its_variable() -> None:
    assert parse_value("POS", "POS 228") == 228
    with pytest.raises(ValueError, match="asked for POS, got 'PRE 228'"):
        parse_value("POS", "PRE 228")
    with pytest.raises(ValueError, match="invalid literal"):
        parse_value("POS", "POS ?")


@pytest.fixture
def bench() -> Iterator[Bench]:
    with emulated_gripper() as bench:
        yield bench


@pytest.fixture
def wire(bench: Bench) -> Iterator[UrcapWire]:
    host, port = bench.emulator.serve_urcap("127.0.0.1")
    wire = UrcapWire(host, port=port)
    wire.open()
    yield wire
    wire.close()


def test_a_lost_or_late_reply_is_asked_for_again(bench: Bench, wire: UrcapWire) -> None:
    for glitch in (mute, late(0.6)):
        bench.emulator.line = first(1, glitch)
        assert wire.read().position == 3


def test_a_dropped_connection_is_opened_again(bench: Bench, wire: UrcapWire) -> None:
    bench.emulator.hang_up()
    wire.write(Command(activate=True))
    assert wire.read().activated


def test_a_connection_that_drops_every_time_is_lost(bench: Bench, wire: UrcapWire) -> None:
    def drop(sent: bytes) -> tuple[float, bytes]:
        for connection in list(bench.emulator._connections):
            connection.transport.abort()
        return 0.0, b""

    bench.emulator.line = drop
    with pytest.raises(DeviceUnreachable, match=r"connection lost \(closed by the other end\)"):
        wire.read()


def test_a_mute_urcap_is_given_up(bench: Bench, wire: UrcapWire) -> None:
    bench.emulator.line = mute
    with pytest.raises(DeviceTimeout, match=r"no answer to 'GET PRE' within 0\.5 s, twice"):
        wire.read()


@pytest.mark.parametrize(
    ("sent", "told"),
    [
        (b"?", r"answered '\?' to GET PRE; is the arm emergency-stopped"),
        (b"POS 3\n", "answered 'POS 3' to GET PRE"),
        (b"PRE many\n", "answered 'PRE many' to GET PRE"),
    ],
)
def test_a_reply_to_something_else_is_told(
    bench: Bench, wire: UrcapWire, sent: bytes, told: str
) -> None:
    bench.emulator.line = lambda _: (0.0, sent)
    with pytest.raises(GripperError, match=told):
        wire.read()


def test_another_grippers_status_is_told(bench: Bench, wire: UrcapWire) -> None:
    bench.emulator.line = lambda sent: (0.0, b"STA 2\n" if sent.startswith(b"STA") else sent)
    with pytest.raises(GripperError, match="not a 2F-85's status: 2 is not a valid Activation"):
        wire.read()


def test_a_refused_command_is_told(bench: Bench, wire: UrcapWire) -> None:
    bench.emulator.refusing = True
    with pytest.raises(GripperError, match=r"answered '\?' to SET"):
        wire.write(Command(activate=True))
