"""The figures as a table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rich.table import Table

from tools.evaluate.metrics import Estimate, Metrics

Key = tuple[str, str]  # policy, set of tables


def figures_table(metrics: Mapping[Key, Metrics]) -> Table:
    table = Table(
        "policy", "tables", "n", "completion %", "grasp success %", "action efficiency %",
        "motions", "ends",
        title="first line: completed episodes, as the papers define it; second line: all",
        caption="means with 95 % intervals",
        show_lines=True,
    )  # fmt: skip
    for (policy, tables), m in metrics.items():
        table.add_row(
            policy,
            tables,
            f"{m.of_completed.episodes}\n{m.of_all.episodes}",
            percent(m.completion),
            f"{percent(m.of_completed.grasp_success)}\n{percent(m.of_all.grasp_success)}",
            f"{percent(m.of_completed.action_efficiency)}\n{percent(m.of_all.action_efficiency)}",
            f"{plain(m.of_completed.motions)}\n{plain(m.of_all.motions)}",
            "\n".join(f"{count} {reason.value}" for reason, count in m.reasons.items()),
        )
    return table


def percent(estimate: Estimate) -> str:
    """91.7 (88 to 94); a dash where no episode counts."""
    if math.isnan(estimate.value):
        return "-"
    return f"{100 * estimate.value:.1f} ({100 * estimate.low:.0f} to {100 * estimate.high:.0f})"


def plain(estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "-"
    return f"{estimate.value:.1f} ({estimate.low:.1f} to {estimate.high:.1f})"
