"""The figures as pictures: the metrics of each set of tables, and what was left over actions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tdpg_deploy.geometry import Array
from tools.evaluate.metrics import EpisodeRow, Estimate, Metrics
from tools.evaluate.terminal import Key

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = ("#4e79a7", "#f28e2b", "#59a14f", "#e15759", "#b07aa1", "#9c755f")  # as the blocks
COLUMNS = 3
STYLE: Any = {  # matplotlib types each of its keys
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": "medium",
    "figure.constrained_layout.use": True,
    "grid.alpha": 0.3,
    "savefig.dpi": 120,
}


def write_plots(
    metrics: Mapping[Key, Metrics], rows: Mapping[Key, Sequence[EpisodeRow]], out: Path
) -> list[Path]:
    """figures.png and left.png in `out`. None of them where matplotlib is not installed."""
    try:
        import matplotlib as mpl
    except ImportError:
        return []
    mpl.use("agg")
    with mpl.rc_context(STYLE):
        pictures = {"figures.png": draw_figures(metrics), "left.png": draw_left(rows)}
        for name, figure in pictures.items():
            figure.savefig(out / name)
    return [out / name for name in pictures]


def draw_figures(metrics: Mapping[Key, Metrics]) -> Figure:
    """A panel for each metric: mean and interval of every policy on every set, of all episodes;
    a hollow mark is the mean of the completed ones."""
    from matplotlib.figure import Figure

    sets, policies = _sets(metrics), _policies(metrics)
    figure = Figure(figsize=(11, 1.6 + 0.24 * len(metrics)))
    panels = figure.subplots(1, 4, sharey=True)
    for panel, title in zip(
        panels, ("completion %", "grasp success %", "action efficiency %", "motions"), strict=True
    ):
        panel.set_title(title)
    for (tables, policy), m in metrics.items():
        place = policies.index(policy)
        y = sets.index(tables) + 0.7 * ((place + 0.5) / len(policies) - 0.5)
        every, completed = m.of_all, m.of_completed
        for panel, whole, part, scale in (
            (panels[0], m.completion, None, 100),
            (panels[1], every.grasp_success, completed.grasp_success, 100),
            (panels[2], every.action_efficiency, completed.action_efficiency, 100),
            (panels[3], every.motions, completed.motions, 1),
        ):
            _mark(panel, y, whole, part, scale, COLORS[place % len(COLORS)])
    panels[0].set_yticks(range(len(sets)), sets)
    panels[0].set_ylim(len(sets) - 0.5, -0.5)
    for place, policy in enumerate(policies):
        panels[0].plot([], [], "o", color=COLORS[place % len(COLORS)], label=policy)
    panels[3].set_xlim(left=0)
    figure.legend(loc="outside lower left", ncols=len(policies), frameon=False)
    figure.text(
        0.995, 0.01, "filled: all episodes, 95 % interval;  ring: completed episodes",
        ha="right", va="bottom", fontsize="small", color="0.4",
    )  # fmt: skip
    return figure


def _mark(
    panel: Axes, y: float, whole: Estimate, part: Estimate | None, scale: float, color: str
) -> None:
    panel.plot([scale * whole.low, scale * whole.high], [y, y], color=color, lw=2, alpha=0.5)
    panel.plot(scale * whole.value, y, "o", color=color, ms=5)
    if part is not None:
        panel.plot(scale * part.value, y, "o", mfc="none", mec=color, ms=9)


def draw_left(rows: Mapping[Key, Sequence[EpisodeRow]]) -> Figure:
    """A panel for each set: how many objects were still to be lifted after so many actions, by
    successful grasps; the mean over episodes, and where the middle half of them lies."""
    from matplotlib.figure import Figure

    sets, policies = _sets(rows), _policies(rows)
    columns = min(COLUMNS, len(sets))
    height = -(-len(sets) // columns)
    figure = Figure(figsize=(3.7 * columns, 0.6 + 2.5 * height))
    panels = np.atleast_1d(figure.subplots(height, columns, squeeze=False).ravel())
    for panel in panels[len(sets) :]:
        panel.remove()
    for (tables, policy), episodes in rows.items():
        panel = panels[sets.index(tables)]
        color = COLORS[policies.index(policy) % len(COLORS)]
        left = left_after(episodes)
        actions = np.arange(left.shape[1])
        low, high = np.percentile(left, [25, 75], axis=0)
        panel.fill_between(actions, low, high, color=color, alpha=0.15, lw=0)
        panel.plot(actions, left.mean(axis=0), color=color, label=policy)
        panel.set_title(tables)
    panels[0].set_ylabel("objects left")
    for panel in panels[: len(sets)]:
        panel.set_xlabel("actions")
        panel.set_xlim(left=0)
        panel.set_ylim(bottom=0)
    panels[0].legend(frameon=False)
    return figure


def left_after(episodes: Sequence[EpisodeRow]) -> Array:
    """(episodes, most actions + 1): objects still to be lifted. What one grasp lifted beside
    another, or a push threw off the table, is known only of completed episodes, at their end."""
    longest = max(row.actions for row in episodes)
    left = np.empty((len(episodes), longest + 1))
    for line, row in zip(left, episodes, strict=True):
        grasped = np.zeros(len(row.lifted)) if row.goal else np.array(row.lifted, np.float64)
        line[0] = row.objects
        line[1 : row.actions + 1] = row.objects - np.cumsum(grasped)
        line[row.actions :] = 0.0 if row.completed else line[row.actions]
    return np.maximum(left, 0.0)


def _sets(keys: Mapping[Key, Any]) -> list[str]:
    return list(dict.fromkeys(tables for tables, _ in keys))


def _policies(keys: Mapping[Key, Any]) -> list[str]:
    return list(dict.fromkeys(policy for _, policy in keys))
