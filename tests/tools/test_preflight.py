from __future__ import annotations

import importlib.util
import shutil
import sys
from types import SimpleNamespace

import pytest

from tools.preflight import problems


def test_this_machine_lacks_nothing_but_perhaps_disk() -> None:
    assert [line for line in problems() if "GB free" not in line] == []


@pytest.mark.parametrize("version", [(3, 9, 2), (3, 12, 0)])
def test_another_python_is_named(
    monkeypatch: pytest.MonkeyPatch, version: tuple[int, int, int]
) -> None:
    monkeypatch.setattr(sys, "version_info", version)
    assert any(f"Python 3.{version[1]} found, 3.11 or 3.10 needed" in line for line in problems())


def test_a_full_disk_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1.2e9))
    assert any("1.2 GB free on this disk, 4.0 GB needed" in line for line in problems())


def test_a_missing_module_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    said = list(problems())
    assert any("ensurepip is missing: apt install python3" in line for line in said)
