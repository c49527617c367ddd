"""Play, read the logs, and show the figures as a table and as JSON."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from policies.shipped import open_policy
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.errors import ConfigError
from tools.evaluate.metrics import EpisodeRow, Estimate, Metrics, evaluate
from tools.evaluate.play import Trial, play_all
from tools.evaluate.rows import read_row


def evaluate_policies(args: argparse.Namespace, console: Console) -> None:
    """Play what is missing under args.out and report all. Raises TdpgError, PolicyError."""
    tables: list[Path | int] = [*args.objects, *args.scene]
    if not tables:
        raise ConfigError("nothing to evaluate on: give --objects or --scene")
    cell = load_cell(args.config or DEFAULT_CELL)
    trials = [
        trial
        for policy in args.policy or [None]
        for table in tables
        for trial in _trials(policy, table, cell, args)
    ]
    rows: dict[tuple[str, str], list[EpisodeRow]] = {}
    done = play_all(trials, workers=args.workers)
    for trial in track(done, "playing", len(trials), console=console):
        row = read_row(trial.log, scene=trial.scene)
        rows.setdefault((_label(trial.policy), trial.scene), []).append(row)
    metrics = {key: evaluate(group) for key, group in rows.items()}
    console.print(_table(metrics))
    (args.out / "figures.json").write_text(_as_json(metrics, rows), encoding="utf-8")


def _trials(
    policy: str | None, table: Path | int, cell: CellConfig, args: argparse.Namespace
) -> list[Trial]:
    named = open_policy(policy)  # fails before anything is played
    version = named.name if named.sha256 is None else named.sha256[:12]
    trials = []
    for number in range(args.episodes):
        seed = args.seed + number
        trial = Trial(policy=policy, cell=cell, table=table, seed=seed, log=Path())
        log = args.out / version / f"{trial.scene.replace(' ', '-')}-{seed}.mcap"
        trials.append(Trial(policy=policy, cell=cell, table=table, seed=seed, log=log))
    return trials


def _label(policy: str | None) -> str:
    return "shipped" if policy is None else Path(policy).stem


def _table(metrics: dict[tuple[str, str], Metrics]) -> Table:
    table = Table(
        "policy", "table", "n", "completion %", "grasp success %", "action efficiency %", "motions",
        title="of completed episodes (the papers' definition); in brackets: of all",
        caption="with 95 % intervals",
    )  # fmt: skip
    for (policy, scene), m in metrics.items():
        table.add_row(
            policy,
            scene,
            str(m.of_all.episodes),
            _percent(m.completion),
            f"{_percent(m.of_completed.grasp_success)} ({100 * m.of_all.grasp_success.value:.1f})",
            f"{_percent(m.of_completed.action_efficiency)} "
            f"({100 * m.of_all.action_efficiency.value:.1f})",
            f"{m.of_completed.motions.value:.1f} ({m.of_all.motions.value:.1f})",
        )
    return table


def _percent(estimate: Estimate) -> str:
    return (
        f"{100 * estimate.value:.1f} [{100 * estimate.low:.0f}, {100 * estimate.high:.0f}]".replace(
            "[", "\\["
        )
    )


def _as_json(
    metrics: dict[tuple[str, str], Metrics], rows: dict[tuple[str, str], list[EpisodeRow]]
) -> str:
    report = [
        {
            "policy": policy,
            "table": scene,
            "metrics": asdict(metrics[policy, scene])
            | {"reasons": _reasons(metrics[policy, scene])},
            "episodes": [asdict(row) | {"reason": row.reason.value} for row in rows[policy, scene]],
        }
        for policy, scene in metrics
    ]
    return json.dumps(report, indent=2) + "\n"


def _reasons(metrics: Metrics) -> dict[str, int]:
    return {reason.value: count for reason, count in metrics.reasons.items()}
