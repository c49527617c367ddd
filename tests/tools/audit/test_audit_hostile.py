"""Logs that mean harm: sound files of right shape, with contents chosen to hurt whoever shows them.

TDPG_FUZZ=3000 pytest tests/tools/audit/test_audit_hostile.py   tries that many.
"""

from __future__ import annotations

import contextlib
import json
import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from audited_logs import HOSTILE
from rewritten_log import rewrite
from synthetic_episode import ABOUT, Synthetic, write_about

from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.episode_log.summary import draw_summary
from tdpg_deploy.errors import LogError
from tools.audit.parquet import TableWriter
from tools.audit.rows import audit_log
from tools.audit.site_build import listed, write_page
from tools.replay.telling import tell_each

LOGS = int(os.environ.get("TDPG_FUZZ", "60")) // 3
BATCHES = 4
DEEP = "[" * 100_000
POISON: list[Any] = [
    None, True, 0, -1, 2**63, -(10**4000), 1e308, -1e308, 5e-324, "", HOSTILE,
    "../../../etc/passwd", "\u202e\x00\u2028", "x" * 1_000_000,
    [], [[]], {}, {"kind": "Push"}, [1e308] * 1000,
]  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "episode.mcap"
    synthetic = Synthetic()
    about = ABOUT.__class__(**{**vars(ABOUT), "scene": None})
    write_about(path, synthetic.episode(2, states=3), about, now=synthetic.now)
    return path


def poisoned(value: Any, rng: np.random.Generator) -> Any:
    """One leaf, or one branch, is another."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = str(rng.choice(sorted(value)))
        return value | {key: poisoned(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.9:
        at = int(rng.integers(len(value)))
        return [*value[:at], poisoned(value[at], rng), *value[at + 1 :]]
    return POISON[int(rng.integers(len(POISON)))]


def poison(name: str, data: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() > 0.15 or name.startswith("schema"):
        return data
    if rng.random() < 0.03:
        return DEEP.encode()
    try:
        document = json.loads(data)
    except ValueError:
        return data  # protobuf; those are mutated in test_log_damage
    changed = poisoned(document, rng)
    return (changed if isinstance(changed, str) else _dump(changed)).encode(errors="replace")


def _dump(value: Any) -> str:
    with contextlib.suppress(ValueError):  # more digits than Python prints
        return json.dumps(value)
    return "1" + "0" * 4000


@pytest.mark.parametrize("batch", range(BATCHES))
def test_nothing_in_a_log_hurts_who_shows_it(whole: Path, tmp_path: Path, batch: int) -> None:
    (tmp_path / "site" / "episodes").mkdir(parents=True)
    for number in range(batch, LOGS, BATCHES):
        rng = np.random.default_rng(number)
        path = tmp_path / f"{number}.mcap"
        with whole.open("rb") as source, path.open("wb") as file:
            rewrite(source, file, partial(poison, rng=rng))
        try:
            log = audit_log(path, name=f"../{HOSTILE}/{number}")
        except LogError:
            continue
        with TableWriter(tmp_path / "tables") as tables:
            tables.add(log)
        write_page(listed(log), tmp_path / "site", earlier=None, later=None)
        with contextlib.suppress(LogError):
            for _, lines in tell_each(read_episode(path)):
                assert all(isinstance(text, str) for _, text in lines)
        draw_summary(read_episode(path))
    outside = {path.name for path in tmp_path.iterdir()} - {"site", "tables"}
    assert all(name.endswith(".mcap") for name in outside)
    for page in (tmp_path / "site").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert text.count("<script") == 2
        assert "owned'</script>" not in text
