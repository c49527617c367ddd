"""The page of faults and the tests that inject them name the same ones."""

from __future__ import annotations

from collections import Counter

from fault_table import table
from test_gripper_camera_faults import CAMERA_FAULTS, GRIPPER_FAULTS
from test_ur5_faults import FAULTS


def test_each_row_is_injected_and_each_fault_has_a_row() -> None:
    injected = Counter([*FAULTS, *GRIPPER_FAULTS, *CAMERA_FAULTS])
    assert injected == Counter(list(table()))
    assert len(injected) >= 40


def test_each_row_says_what_a_person_sees() -> None:
    assert [row.fault for row in table().values() if not row.says] == ["ctrl-c"]
