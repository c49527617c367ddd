"""Step by step in the terminal: one log, or two side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import zip_longest

from rich.console import Console
from rich.table import Table
from rich.text import Text

from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.errors import LogError
from tools.replay import telling
from tools.replay.telling import Line

STYLES = {
    "success": "green",
    "failed": "red",
    "unclear": "yellow",
    "refused": "yellow",
    "differs": "red",
    "cause": "red",
    "why": "red",
    "again": "cyan",
}


def show_head(console: Console, episode: Episode) -> None:
    about = episode.about
    console.print(str(episode.path), style="bold", markup=False, soft_wrap=True)
    weights = "" if about.checkpoint_sha256 is None else f" ({about.checkpoint_sha256[:12]})"
    seed = "unknown" if about.seed is None else about.seed
    console.print(
        f"{about.cell.name} cell, policy {about.policy}{weights}, seed {seed}, "
        f"commit {about.commit or 'unknown'}",
        markup=False,
        soft_wrap=True,
    )
    console.print(telling.result(episode.result()), markup=False)


class Stepper:
    """Shows steps from number `first` on; with `wait`, asks before each next one."""

    def __init__(self, console: Console, *, first: int, wait: bool) -> None:
        self.console = console
        self.damage: list[LogError] = []
        self._first = first
        self._wait = wait

    def show(self, *columns: Callable[[], Iterable[list[Line]]]) -> None:
        """Each column, when called, gives the lines of one step after the other, from the first.
        One that breaks off with a LogError ends there; the errors are kept in `damage`."""
        first: int | None = self._first
        while first is not None:
            self.damage.clear()
            first = self._play(first, [self._until_damage(column()) for column in columns])

    def _play(self, first: int, columns: list[Iterator[list[Line]]]) -> int | None:
        """From step `first` on. Returns the step to go back to, None if that was all."""
        number, shown = 0, False
        for number, told in enumerate(zip_longest(*columns, fillvalue=None), start=1):
            if number < first:
                continue
            shown = True
            self.console.rule(f"step {number}", align="left", style="dim")
            self.console.print(_side_by_side(told))
            if not self._wait:
                continue
            asked = self._ask()
            if asked is None:
                return None
            first = asked or number + 1
            if first <= number:
                return first
        if first <= number + shown:
            return None
        self.console.print(f"the log has {number} steps")
        return number if self._wait and number else None

    def _ask(self) -> int | None:
        """The step to go to, 0 for the next one, None to end."""
        try:
            answer = self.console.input("[dim]Enter: next, a number: go there, q: quit[/] ").strip()
        except EOFError:
            self.console.print()  # Ctrl-D leaves the cursor on the line
            return None
        if answer == "q":
            return None
        return int(answer) if answer.isdecimal() and len(answer) < 10 else 0

    def _until_damage(self, steps: Iterable[list[Line]]) -> Iterator[list[Line]]:
        try:
            yield from steps
        except LogError as error:
            self.damage.append(error)


def _side_by_side(told: tuple[list[Line] | None, ...]) -> Table:
    grid = Table.grid(padding=(0, 2), expand=len(told) > 1)
    for _ in told:
        grid.add_column(ratio=1)
    grid.add_row(
        *(Text("no such step", "dim") if lines is None else _lines(lines) for lines in told)
    )
    return grid


def _lines(lines: list[Line]) -> Table:
    table = Table.grid(padding=(0, 2))
    for label, text in lines:
        table.add_row(Text(label, "dim"), Text(text, STYLES.get(text, STYLES.get(label, ""))))
    return table
