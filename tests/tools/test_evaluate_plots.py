from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from tdpg_deploy.outcome import EndReason
from tools.evaluate.metrics import EpisodeRow, evaluate
from tools.evaluate.plots import left_after, write_plots
from tools.evaluate.terminal import figures_table


def row(reason: EndReason, lifted: list[bool], *, objects: int, goal: bool = False) -> EpisodeRow:
    return EpisodeRow(
        scene="table", seed=0, reason=reason, objects=objects, actions=len(lifted),
        grasps=len(lifted), grasp_successes=sum(lifted), goal=goal, lifted=tuple(lifted),
    )  # fmt: skip


CLEARED = row(EndReason.CLEARED, [True, False, True], objects=3)  # one grasp took two
STUCK = row(EndReason.STUCK, [True, False, False, False], objects=3)
FETCHED = row(EndReason.GOAL_REACHED, [True, True], objects=1, goal=True)


def test_what_is_left_after_each_action() -> None:
    assert left_after([CLEARED, STUCK]).tolist() == [[3, 2, 2, 0, 0], [3, 2, 2, 2, 2]]
    assert left_after([FETCHED]).tolist() == [[1, 1, 0]]


def test_plots_are_drawn_even_where_nothing_was_completed(tmp_path: Path) -> None:
    rows = {
        ("random 3", "one"): [CLEARED, STUCK],
        ("random 3", "two"): [STUCK],
        ("cases, goal", "one"): [FETCHED],
    }
    files = write_plots({key: evaluate(group) for key, group in rows.items()}, rows, tmp_path)
    assert [file.name for file in files] == ["figures.png", "left.png"]
    for file in files:
        picture = cv2.imread(str(file))
        assert picture is not None
        assert np.ptp(picture) > 100


def test_the_table_shows_both_counts_and_the_ends() -> None:
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(figures_table({("random 3", "[x]"): evaluate([CLEARED, STUCK])}))
    text = console.export_text()
    for shown in ("random 3", "[x]", "1 cleared", "1 stuck", "66.7 (45.8)", "100.0 (62.5)"):
        assert shown in text
