"""Files that are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.train.whole import written_whole


def test_what_is_written_takes_the_place_of_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "state.pt"
    path.write_bytes(b"before")
    with written_whole(path) as file:
        file.write(b"after")
        file.flush()
        assert path.read_bytes() == b"before"
    assert path.read_bytes() == b"after"
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_cut_short_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "state.pt"
    path.write_bytes(b"before")
    with pytest.raises(KeyboardInterrupt):
        _write_and_be_interrupted(path)
    assert path.read_bytes() == b"before"


def _write_and_be_interrupted(path: Path) -> None:
    with written_whole(path) as file:
        file.write(b"aft")
        raise KeyboardInterrupt
