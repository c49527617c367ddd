"""The audit in the terminal: figures, causes with a sample of evidence each, comparisons."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tools.audit.causes import WHAT_TO_CHANGE, Cause
from tools.audit.compare import Comparison, figures
from tools.audit.tally import Causes, Tally
from tools.evaluate.metrics import Estimate, evaluate

if TYPE_CHECKING:
    from tools.audit.sql import Answer


def show_summary(console: Console, folder: Path, tally: Tally) -> None:
    console.print(
        f"{folder}: {tally.episodes} episodes ({tally.truncated} truncated), {tally.actions} "
        f"actions, {sum(tally.failures.counts.values())} without success",
        markup=False,
        soft_wrap=True,
    )
    if tally.rows:
        metrics = evaluate(tally.rows)
        table = Table("figure", "mean", "95 % interval", title="complete logs")
        for name, estimate in figures(metrics).items():
            table.add_row(name, *_estimate(name, estimate))
        console.print(table)
        ends = ", ".join(f"{reason.value} {n}" for reason, n in metrics.reasons.items())
        console.print(f"ended: {ends}")
    _show_causes(console, "episodes that failed", tally.ends, tally.episodes)
    _show_causes(console, "actions without success", tally.failures, tally.actions)
    if tally.refusals:
        refused = ", ".join(f"{cause} {n}" for cause, n in tally.refusals.most_common())
        console.print(f"refused plans: {refused}")
    _show_changes(console, tally)
    for file in tally.unreadable:
        console.print(f"not read: {file.why}", style="yellow", markup=False, soft_wrap=True)


def _show_causes(console: Console, title: str, causes: Causes, total: int) -> None:
    if not causes.counts:
        return
    table = Table("cause", "n", "share %", "for example", title=title)
    for cause, count in causes.counts.most_common():
        share_text = f"{100 * count / total:.1f}"
        table.add_row(cause, str(count), share_text, escape(causes.samples[cause]))
    console.print(table)


def _show_changes(console: Console, tally: Tally) -> None:
    causes = dict.fromkeys([*_by_count(tally.ends), *_by_count(tally.failures)])
    if not causes:
        return
    table = Table("cause", "what to change")
    for cause in causes:
        table.add_row(cause, WHAT_TO_CHANGE[Cause(cause)])
    console.print(table)


def _by_count(causes: Causes) -> list[str]:
    return [cause for cause, _ in causes.counts.most_common()]


def show_comparison(
    console: Console, one: Path, other: Path, comparisons: list[Comparison]
) -> None:
    table = Table(
        "figure", "A", "B", "B - A", "95 % interval", "",
        title="A and B", caption="shares in %; causes as shares of all actions",
    )  # fmt: skip
    for row in comparisons:
        (a, _), (b, _) = _estimate(row.name, row.one), _estimate(row.name, row.other)
        change, interval = _estimate(row.name, row.difference, signed=True)
        table.add_row(row.name, a, b, change, interval, "clear" if row.is_clear else "")
    console.print(f"A: {one}\nB: {other}", markup=False, soft_wrap=True)
    console.print(table)


def show_answer(console: Console, answer: Answer) -> None:
    table = Table(*map(escape, answer.columns))
    for row in answer.rows:
        table.add_row(*(_cell(value) for value in row))
    console.print(table)
    if answer.more:
        console.print(f"the first {len(answer.rows)} rows; query the Parquet files for the rest")


def _cell(value: Any) -> str:
    return f"{value + 0.0:.4g}" if isinstance(value, float) else escape(str(value))  # no "-0"


def _estimate(name: str, estimate: Estimate, *, signed: bool = False) -> tuple[str, str]:
    """Mean and interval; a share in per cent."""
    scale = 1 if name.startswith("motions") else 100
    sign = "+" if signed else ""
    low, high = (f"{scale * bound:{sign}.1f}" for bound in (estimate.low, estimate.high))
    return f"{scale * estimate.value:{sign}.1f}", f"{low} to {high}"
