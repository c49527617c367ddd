from __future__ import annotations

from pathlib import Path

import pytest

from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.emulators.cell_file import emulated, format_cell

MOCK = load_cell(DEFAULT_CELL)


def at(host: str) -> CellConfig:
    return MOCK.model_copy(update={"arm": MOCK.arm.model_copy(update={"host": host})})


@pytest.mark.parametrize(
    ("asked", "served"),
    [
        ("127.3.2.1", "127.3.2.1"),
        ("192.168.0.2", "127.0.0.1"),
        ("ur5.local", "127.0.0.1"),
        ("10.0.0.1", "127.0.0.1"),
    ],
)
def test_it_stays_on_this_machine(asked: str, served: str) -> None:
    config = emulated(at(asked))
    assert config.arm.host == config.gripper.host == served
    assert config.camera.emulated == (served, 30435)


def test_a_written_cell_is_the_same_when_read(tmp_path: Path) -> None:
    config = emulated(MOCK).model_copy(update={"name": 'with "quotes" and \\ and ü'})
    camera = config.camera.model_copy(update={"filters": ("spatial",), "emitter": False})
    config = config.model_copy(update={"camera": camera})
    file = tmp_path / "cell.toml"
    file.write_text(format_cell(config), encoding="utf-8")
    assert load_cell(file) == config


def test_it_says_only_what_differs() -> None:
    assert "[limits]" in format_cell(MOCK)
    assert "joint_speed" not in format_cell(MOCK)
