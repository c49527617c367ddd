"""The wires themselves: several clients, faults of the line, and nothing left behind."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tdpg_deploy.emulators.robotiq import KinematicJaws, RobotiqModel
from tdpg_deploy.emulators.robotiq_urcap import reply_to
from tdpg_deploy.emulators.robotiq_wires import (
    RobotiqEmulator,
    clean,
    corrupt,
    first,
    late,
    mute,
)

READ_STATUS = bytes.fromhex("090407D00003B1CE")  # 2F-85 manual
OTHER_UNIT = bytes.fromhex("080407D00003B01F")


def new_emulator() -> RobotiqEmulator:
    return RobotiqEmulator(RobotiqModel(KinematicJaws(time.monotonic), time.monotonic))


@pytest.fixture
def emulator() -> Iterator[RobotiqEmulator]:
    with new_emulator() as emulator:
        yield emulator


def talk(address: tuple[str, int], request: bytes, *, wait: float = 2.0) -> bytes:
    with socket.create_connection(address, wait) as connection:
        connection.sendall(request)
        try:
            return connection.recv(256)
        except TimeoutError:
            return b""


def test_a_unit_answers_to_its_own_address_only(emulator: RobotiqEmulator) -> None:
    address = emulator.serve_rtu_over_tcp("127.0.0.1")
    assert talk(address, OTHER_UNIT + READ_STATUS)[:3] == bytes.fromhex("090406")
    assert len(talk(address, OTHER_UNIT + READ_STATUS)) == 11


def test_the_line_can_be_mute_damaged_late_and_mend(emulator: RobotiqEmulator) -> None:
    address = emulator.serve_rtu_over_tcp("127.0.0.1")
    good = talk(address, READ_STATUS)
    emulator.line = first(1, mute)
    assert talk(address, READ_STATUS, wait=0.05) == b""
    assert talk(address, READ_STATUS) == good
    emulator.line = corrupt
    damaged = talk(address, READ_STATUS)
    assert damaged != good
    assert damaged[:-1] == good[:-1]
    emulator.line = late(0.1)
    assert talk(address, READ_STATUS, wait=0.05) == b""
    emulator.line = clean
    assert talk(address, READ_STATUS) == good


def test_without_power_rtu_is_silent_and_the_urcap_refuses(emulator: RobotiqEmulator) -> None:
    rtu, urcap = emulator.serve_rtu_over_tcp("127.0.0.1"), emulator.serve_urcap("127.0.0.1")
    emulator.model.cut_power()
    assert talk(rtu, READ_STATUS, wait=0.05) == b""
    assert talk(urcap, b"GET POS\n") == b"?"
    emulator.model.restore_power()
    assert talk(rtu, READ_STATUS) != b""
    assert talk(urcap, b"GET POS\n") == b"POS 3\n"


def test_several_clients_share_one_gripper(emulator: RobotiqEmulator) -> None:
    rtu, urcap = emulator.serve_rtu_over_tcp("127.0.0.1"), emulator.serve_urcap("127.0.0.1")
    assert talk(urcap, b"SET ACT 1\n") == b"ack"
    assert talk(rtu, READ_STATUS)[3] & 0x11 == 0x11  # gACT, gSTA in progress
    assert talk(urcap, b"GET STA\nGET FLT\n").startswith(b"STA 1\n")


def test_hanging_up_drops_clients_and_welcomes_new_ones(emulator: RobotiqEmulator) -> None:
    address = emulator.serve_urcap("127.0.0.1")
    with socket.create_connection(address, 2.0) as connection:
        connection.sendall(b"GET POS\n")
        assert connection.recv(64) == b"POS 3\n"
        assert emulator.connections == 1
        emulator.hang_up()
        assert connection.recv(64) == b""
    assert talk(address, b"GET POS\n") == b"POS 3\n"


def test_closing_leaves_no_thread_port_or_terminal() -> None:
    threads, files = threading.active_count(), len(os.listdir("/proc/self/fd"))
    emulator = new_emulator()
    pty = emulator.serve_pty()
    host, port = emulator.serve_urcap("127.0.0.1")
    emulator.serve_rtu_over_tcp("127.0.0.1")
    with socket.create_connection((host, port), 2.0) as connection:
        connection.sendall(b"GET POS\n")
        assert connection.recv(64) == b"POS 3\n"
        emulator.close()
    emulator.close()
    assert threading.active_count() == threads
    assert len(os.listdir("/proc/self/fd")) == files
    assert not os.path.exists(pty)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((host, port), 2.0)


class Words:
    """Registers without a gripper behind them."""

    def __init__(self) -> None:
        self.words = {1000: 0, 1001: 0, 1002: 0, 2000: 0xF900, 2001: 0x05E4, 2002: 0xBD00}

    def read(self, address: int, count: int) -> list[int]:
        return [self.words[a] for a in range(address, address + count)]

    def write(self, address: int, words: list[int]) -> None:
        self.words |= dict(enumerate(words, start=address))


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        ("GET POS", b"POS 189\n"),
        ("GET STA", b"STA 3\n"),
        ("GET OBJ", b"OBJ 3\n"),
        ("GET PRE", b"PRE 228\n"),
        ("GET FLT", b"FLT 5\n"),
        ("GET", b"?"),
        ("GET XYZ", b"?"),
        ("SET", b"?"),
        ("SET POS", b"?"),
        ("SET POS 256", b"?"),
        ("SET POS -1", b"?"),
        ("SET STA 3", b"?"),
        ("", b"?"),
        ("SET POS 255 SPE 254 FOR 100 GTO 1", b"ack"),
    ],
)
def test_the_urcaps_sentences(line: str, reply: bytes) -> None:
    assert reply_to(line, Words()) == reply


def test_a_set_changes_what_it_names_and_nothing_else() -> None:
    words = Words()
    reply_to("SET ACT 1 FOR 7", words)
    reply_to("SET POS 255 SPE 254 GTO 1", words)
    assert [words.words[a] for a in (1000, 1001, 1002)] == [0x0900, 255, 254 << 8 | 7]


@given(st.text(max_size=40))
def test_whatever_is_said_the_urcap_answers(line: str) -> None:
    assert reply_to(line, Words())
