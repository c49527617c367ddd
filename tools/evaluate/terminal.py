"""The figures as a table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rich import box
from rich.markup import escape
from rich.table import Table

from tools.evaluate.metrics import Estimate, Metrics

Key = tuple[str, str]  # set of tables, policy


def figures_table(metrics: Mapping[Key, Metrics]) -> Table:
    table = Table(
        box=box.SIMPLE_HEAD,
        padding=(0, 1),
        pad_edge=False,
        caption="mean over completed episodes, as the papers count, and (over all)\n"
        "[95 % interval of the first]",
    )
    table.add_column("tables", no_wrap=True)
    for title in ("n", "complete %", "grasps %", "effic. %", "motions"):
        table.add_column(title, justify="right", no_wrap=True)
    for (tables, policy), m in metrics.items():
        completed, every = m.of_completed, m.of_all
        ends = [f"  {count} {reason.value}" for reason, count in m.reasons.items()]
        table.add_row(
            "\n".join([f"[bold]{escape(tables)}[/]", escape(policy), *ends]),
            str(every.episodes),
            _percent(m.completion, None),
            _percent(completed.grasp_success, every.grasp_success),
            _percent(completed.action_efficiency, every.action_efficiency),
            _cell(completed.motions, every.motions, 1, "[{:.1f}, {:.1f}]"),
            end_section=True,
        )
    return table


def _percent(mean: Estimate, of_all: Estimate | None) -> str:
    return _cell(mean, of_all, 100, "[{:.0f}, {:.0f}]")


def _cell(mean: Estimate, of_all: Estimate | None, scale: float, interval: str) -> str:
    """A dash where no episode counts."""
    whole = "" if of_all is None else f" ({scale * of_all.value:.1f})"
    if math.isnan(mean.value):
        return f"-{whole}"
    bounds = escape(interval.format(scale * mean.low, scale * mean.high))
    return f"{scale * mean.value:.1f}{whole}\n[dim]{bounds}[/]"
