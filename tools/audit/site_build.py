"""A site to look through: an overview, and a page for each episode. Works from disk, offline.

Pages carry their data as JSON and are drawn by scripts that put text in as text, never as HTML.
"""

from __future__ import annotations

import html
import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.errors import ConfigError, LogError
from tdpg_deploy.outcome import EndReason
from tools.audit.actions import explain_action
from tools.audit.causes import WHAT_TO_CHANGE, Finding
from tools.audit.compare import figures
from tools.audit.engines import Engine, in_parallel
from tools.audit.episode_data import findings_data, number, step_data
from tools.audit.episodes import explain_interruption
from tools.audit.rows import AuditedLog, EpisodeRecord
from tools.audit.site_images import write_images
from tools.audit.tally import Tally
from tools.evaluate.metrics import evaluate

_PLACE = re.compile(r"\{\{(\w+)\}\}")
_CHANGES = {cause.value: text for cause, text in WHAT_TO_CHANGE.items()}
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


@dataclass(frozen=True, kw_only=True)
class Listed:
    """What the overview needs of a log. tried: how many actions were begun; failures: how many
    of them failed of which cause."""

    record: EpisodeRecord
    findings: tuple[Finding, ...]
    tried: int
    failures: dict[str, int]


@dataclass(frozen=True, kw_only=True)
class Page:
    """An episode's page to write. earlier, later: slugs of its neighbours."""

    listed: Listed
    out: Path
    earlier: str | None
    later: str | None


def listed(log: AuditedLog) -> Listed:
    tried = [action for action in log.actions if action.kind != "none"]
    failures = Counter(action.cause for action in tried if action.cause is not None)
    return Listed(
        record=log.episode, findings=log.findings, tried=len(tried), failures=dict(failures)
    )


def write_site(
    out: Path, logs: Sequence[Listed], tally: Tally, *, workers: int, engine: Engine
) -> Iterator[str]:
    """Write index.html and episodes/*; yields the name of each episode whose page is done."""
    try:
        (out / "episodes").mkdir(parents=True, exist_ok=True)
        (out / "index.html").write_text(_index(logs, tally), encoding="utf-8")
        slugs = [slug(log.record.episode) for log in logs]
        pages = (
            Page(listed=log, out=out, earlier=earlier, later=later)
            for log, earlier, later in zip(logs, [None, *slugs], [*slugs[1:], None], strict=False)
        )
        yield from in_parallel(_write_page, pages, workers=workers, engine=engine)
    except OSError as error:
        raise ConfigError(f"{out}: pages cannot be written ({error})") from error


def slug(episode: str) -> str:
    """A name for files and links; different for different episodes."""
    safe = _UNSAFE.sub("_", episode)
    return safe if safe == episode else f"{safe}-{sha256(episode.encode()).hexdigest()[:6]}"


def _write_page(page: Page) -> str:
    write_page(page.listed, page.out, earlier=page.earlier, later=page.later)
    return page.listed.record.episode


def write_page(log: Listed, out: Path, *, earlier: str | None, later: str | None) -> None:
    """Into the folder out/episodes. earlier, later: slugs of the neighbours."""
    record = log.record
    name = slug(record.episode)
    episode = read_episode(Path(record.path))
    cell = episode.about.cell
    reason = None if record.reason is None else EndReason(record.reason)
    interruption = explain_interruption(reason, record.error)
    steps, previous = [], None
    with suppress(LogError):  # told by the record's evidence
        for step in episode.steps(images=False):
            steps.append(step_data(step, explain_action(step, previous, interruption), cell))
            previous = step
    images = write_images(episode, out / "episodes" / name)
    data = {
        "episode": record_data(record),
        "findings": findings_data(log.findings),
        "steps": steps,
        "looks": images.looks,
        "q_maps": images.q_maps,
        "folder": name,
        "earlier": earlier,
        "later": later,
    }
    target = out / "episodes" / f"{name}.html"
    target.write_text(_page(f"{record.episode} · audit", "episode.js", data), encoding="utf-8")


def _index(logs: Sequence[Listed], tally: Tally) -> str:
    shown = figures(evaluate(tally.rows)) if tally.rows else {}
    data = {
        "figures": {
            name: [number(e.value, 6), number(e.low, 6), number(e.high, 6)]
            for name, e in shown.items()
        },
        "episodes": [
            record_data(log.record) | {"tried": log.tried, "action_causes": log.failures}
            for log in logs
        ],
        "actions": tally.actions,
        "unreadable": [file.why for file in tally.unreadable],
    }
    return _page("Audit", "index.js", data)


def record_data(record: EpisodeRecord) -> dict[str, Any]:
    plain = {
        key: number(value) if isinstance(value, float) else value
        for key, value in asdict(record).items()
    }
    return plain | {"started_at": record.started_at.isoformat(), "slug": slug(record.episode)}


def _page(title: str, script: str, data: dict[str, Any]) -> str:
    """One self-contained HTML file."""
    parts = {
        "title": html.escape(title),
        "style": _asset("style.css"),
        "script": _asset("draw.js") + _asset(script),
        "data": as_script_data(data | {"changes": _CHANGES}),
    }
    return _PLACE.sub(lambda place: parts[place[1]], _asset("page.html"))


def as_script_data(data: dict[str, Any]) -> str:
    """JSON that nothing within can end: no "<" is left that might close the element."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))  # ASCII
    return text.replace("<", "\\u003c")


def _asset(name: str) -> str:
    return (files("tools") / "audit" / "site" / name).read_text(encoding="utf-8")
