from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tdpg_deploy.drivers.robotiq_registers import (
    Activation,
    Command,
    Contact,
    CountScale,
    Fault,
    force_counts,
    parse_status,
    speed_counts,
)


def words(hexadecimal: str) -> list[int]:
    data = bytes.fromhex(hexadecimal)
    return [int.from_bytes(data[i : i + 2], "big") for i in range(0, len(data), 2)]


def test_commands_as_the_manual_prints_them() -> None:
    # 2F-85 manual, Modbus RTU example: open at full speed and force; activation; its reset.
    opening = Command(activate=True, go_to=True, position=0, speed=255, force=255)
    assert list(opening.registers()) == words("0900 0000 FFFF")
    assert list(Command(activate=True).registers()) == words("0100 0000 0000")
    assert list(Command(activate=False).registers()) == words("0000 0000 0000")


def test_status_of_an_open_gripper_as_the_manual_prints_it() -> None:
    status = parse_status(words("F900 0000 0D00"))
    assert status.is_ready
    assert status.going
    assert status.contact is Contact.AT_REQUEST
    assert status.fault is Fault.NONE
    assert (status.echo, status.position, status.current) == (0, 13, 0.0)


def test_status_of_a_grasp_as_the_manual_prints_it() -> None:
    status = parse_status(words("B900 00FF BD00"))
    assert status.activation is Activation.ACTIVE
    assert status.contact is Contact.WHILE_CLOSING
    assert (status.echo, status.position) == (0xFF, 0xBD)


@given(st.lists(st.integers(0, 0xFFFF), min_size=3, max_size=3))
def test_any_registers_give_a_status_or_a_value_error(registers: list[int]) -> None:
    try:
        status = parse_status(registers)
    except ValueError:
        sta, fault = registers[0] >> 12 & 3, registers[1] >> 8 & 0xF
        assert sta == 2 or fault in (1, 2, 3, 4, 6)
    else:
        assert status.current == pytest.approx((registers[2] & 0xFF) * 0.010)


def test_a_short_answer_is_no_status() -> None:
    with pytest.raises(ValueError, match="3 registers, got 2"):
        parse_status([0, 0])


def test_the_controllers_own_fault_nibble_is_not_the_grippers() -> None:
    assert parse_status([0, 0xF000, 0]).fault is Fault.NONE


def test_every_fault_says_what_to_do() -> None:
    assert all(len(fault.remedy) > 5 for fault in Fault)
    assert {fault for fault in Fault if fault.is_major} == set(map(Fault, range(0xA, 0x10)))


def test_speed_and_force_span_what_the_manual_specifies() -> None:
    assert [speed_counts(v) for v in (0.0, 0.020, 0.072, 0.150, 9.0)] == [0, 0, 102, 255, 255]
    assert [force_counts(f) for f in (0.0, 20.0, 235.0, 900.0)] == [0, 0, 255, 255]


def test_ends_of_the_scale() -> None:
    scale = CountScale(open_counts=3, closed_counts=228)
    assert (scale.counts(0.085), scale.counts(0.0)) == (3, 228)
    assert (scale.width(3), scale.width(228)) == (0.085, 0.0)
    assert (scale.width(0), scale.width(255)) == (0.085, 0.0)
    assert (scale.counts(0.2), scale.counts(-0.1)) == (3, 228)


@given(st.integers(0, 30), st.integers(200, 255), st.floats(0, 0.085))
def test_a_width_survives_its_counts_within_half_a_count(
    open_counts: int, closed_counts: int, width: float
) -> None:
    scale = CountScale(open_counts=open_counts, closed_counts=closed_counts)
    half = 0.085 / (closed_counts - open_counts) / 2
    assert abs(scale.width(scale.counts(width)) - width) <= half * 1.001
