"""Play, read the logs, and show the figures as a table, as JSON and as plots."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.progress import track

from policies.shipped import open_policy
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.episode_log.reader import read_episode
from tools.evaluate.metrics import EpisodeRow, Metrics, evaluate
from tools.evaluate.play import Trial, play_all
from tools.evaluate.plots import write_plots
from tools.evaluate.rows import read_row
from tools.evaluate.tables import RandomTable, SceneTable, Table, challenge_cases
from tools.evaluate.terminal import Key, figures_table

PAPER_OBJECTS = (15, 20, 25, 30)  # the paper, section IV-A
PAPER_GOAL_OBJECTS = (30,)
NOVEL_OBJECTS = (10,)


Rows = dict[Key, list[EpisodeRow]]


def evaluate_policies(args: argparse.Namespace, console: Console) -> None:
    """Judge args.logs, or play what is missing under args.out; report all.

    Raises TdpgError, PolicyError.
    """
    rows = _judged(args.logs) if args.logs else _played(args, console)
    metrics = {key: evaluate(episodes) for key, episodes in rows.items()}
    console.print(figures_table(metrics))
    args.out.mkdir(parents=True, exist_ok=True)
    report = args.out / "figures.json"
    report.write_text(as_json(metrics, rows), encoding="utf-8")
    plots = write_plots(metrics, rows, args.out)
    for file in (report, *plots):
        console.print(str(file), markup=False, soft_wrap=True)
    if not plots:
        console.print("no plots: pip install 'tdpg-deploy[eval]'", markup=False)


def _judged(logs: Sequence[Path]) -> Rows:
    """Of whatever cell: its name stands for the tables."""
    rows: Rows = {}
    for log in logs:
        about = read_episode(log).about
        row = read_row(log, scene=about.cell.name)
        rows.setdefault((_titled(about.cell.name, row.goal), about.policy), []).append(row)
    return rows


def _played(args: argparse.Namespace, console: Console) -> Rows:
    cell = load_cell(args.config or DEFAULT_CELL)
    trials = [
        trial
        for table in tables_of(args)
        for policy in args.policy or [None]
        for trial in _trials(policy, table, cell, args)
    ]
    rows: Rows = {}
    done = play_all(trials, workers=args.workers)
    for trial in track(done, "playing", len(trials), console=console):
        row = read_row(trial.log, scene=trial.table.name)
        for group in trial.table.groups:
            rows.setdefault((_titled(group, args.goal), _label(trial.policy)), []).append(row)
    return rows


def tables_of(args: argparse.Namespace) -> list[Table]:
    """What was asked for; the paper's tables where nothing was."""
    objects, novel, cases = args.objects, args.novel, args.cases
    if not (objects or novel or cases or args.scene):
        cases = True
        objects, novel = (PAPER_GOAL_OBJECTS, ()) if args.goal else (PAPER_OBJECTS, NOVEL_OBJECTS)
    return [
        *(RandomTable(objects=n) for n in objects),
        *(challenge_cases() if cases else []),
        *(RandomTable(objects=n, novel=True) for n in novel),
        *(SceneTable(file=file) for file in args.scene),
    ]


def _trials(
    policy: str | None, table: Table, cell: CellConfig, args: argparse.Namespace
) -> list[Trial]:
    named = open_policy(policy, goal=args.goal)  # fails before anything is played
    version = named.name if named.sha256 is None else named.sha256[:12]
    name = table.name + ("-goal" if args.goal else "")
    return [
        Trial(
            policy=policy,
            cell=cell,
            table=table,
            goal=args.goal,
            seed=seed,
            log=args.out / version / f"{name}-{seed}.mcap",
        )
        for seed in range(args.seed, args.seed + args.episodes)
    ]


def _label(policy: str | None) -> str:
    return "shipped" if policy is None else Path(policy).stem


def _titled(group: str, goal: bool) -> str:
    return f"{group}, goal" if goal else group


def as_json(metrics: Mapping[Key, Metrics], rows: Mapping[Key, Sequence[EpisodeRow]]) -> str:
    """All figures and all episodes behind them."""
    report = [
        {
            "tables": tables,
            "policy": policy,
            "metrics": asdict(m) | {"reasons": {r.value: n for r, n in m.reasons.items()}},
            "episodes": [
                asdict(row) | {"reason": row.reason.value} for row in rows[tables, policy]
            ],
        }
        for (tables, policy), m in metrics.items()
    ]
    return json.dumps(report, indent=2) + "\n"
