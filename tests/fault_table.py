"""docs/faults.md as data, and episodes in which its faults strike.

An episode is the one that tdpg-run runs: a cell is entered, a log is opened, the loop makes ready,
looks and asks its policy; there the fault strikes.
"""

from __future__ import annotations

import builtins
import functools
import re
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from policies.heightmap import Heightmap
from policies.policy import Decision
from policies.primitives import Primitive
from tdpg_deploy import errors
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.drivers import ur5_status
from tdpg_deploy.episode import run_episode
from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.entries import End, Entry
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.episode_log.writer import EpisodeWriter
from tdpg_deploy.errors import DeviceError
from tdpg_deploy.hal import ArmState, Clock, Intrinsics, RgbdFrame
from tdpg_deploy.outcome import EndReason
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.workspace import workspace_of

PAGE = Path(__file__).parents[1] / "docs" / "faults.md"
GAP = " … "


@dataclass(frozen=True, kw_only=True)
class Row:
    """A line of the page. on: what the fault strikes. arm: "stays" or "stops". log: "none", or the
    reason for the episode's end."""

    fault: str
    on: tuple[str, ...]
    raised: type[BaseException]
    says: str
    arm: str
    log: str

    def is_told_by(self, text: str) -> bool:
        pattern = ".*".join(map(re.escape, self.says.split(GAP)))
        return re.search(pattern, text, re.DOTALL) is not None


@functools.cache
def table() -> dict[str, Row]:
    """All rows, by name."""
    found: dict[str, Row] = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = re.split(r" \| ", line.strip("| "))
        if line[:2] == "| " and cells[0] != "fault":
            fault, _, on, seen, arm, log, _ = cells
            kind, _, says = seen.partition(": ")
            assert fault not in found, f"{fault} stands twice on the page"
            found[fault] = Row(
                fault=fault, on=tuple(on.split(", ")), raised=_kind(kind), says=says,
                arm=arm, log=log,
            )  # fmt: skip
    return found


def _kind(name: str) -> type[BaseException]:
    sources = (errors, ur5_status, builtins)
    kind: type[BaseException] = next(getattr(s, name) for s in sources if hasattr(s, name))
    return kind


# --- an episode in which a fault strikes ------------------------------------------------------


def config() -> CellConfig:
    """The mock cell with the smaller picture."""
    cell = load_cell(DEFAULT_CELL)
    return cell.model_copy(update={"camera": cell.camera.model_copy(update={"width": 640})})


@functools.cache
def picture() -> RgbdFrame:
    """A table with an object."""
    scene = random_scene(1, workspace_of(config()), np.random.default_rng(0))
    with open_cell(config(), scene=scene) as cell:
        return cell.camera.capture()


class StillCamera:
    """`hal.Camera` that always sees the same."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._sequence = 0

    @property
    def intrinsics(self) -> Intrinsics:
        return picture().intrinsics

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        self._sequence += 1
        return replace(picture(), captured_at=self._clock.now(), sequence=self._sequence)


class Deed:
    """A `Decider` that does harm where it should decide. `record` takes arm states to the log."""

    def __init__(self, act: Callable[[], object]) -> None:
        self._act = act
        self.raised: BaseException | None = None
        self.record: Callable[[ArmState], None] = lambda state: None

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        try:
            self._act()
        except BaseException as error:
            self.raised = error
            raise
        raise AssertionError("the deed did no harm")


def strike(cell: Cell, deed: Deed, log: Path, open_cells: ExitStack) -> BaseException:
    """What was raised, in an episode or before it. The cell stays open in `open_cells`."""
    about = About(cell=cell.config, policy="a deed", started_at=0.0)
    try:
        open_cells.enter_context(cell)
        with EpisodeWriter(log, about, now=cell.clock.now) as writer:
            deed.record = writer.arm_state
            run_episode(cell, deed, rng=np.random.default_rng(0), log=writer)
    except (DeviceError, OSError) as error:
        return error
    assert deed.raised is not None
    return deed.raised


def check_log(log: Path, row: Row, raised: BaseException) -> None:
    """Closed, readable to its end, which tells how the episode ended; or never begun."""
    if row.log == "none":
        assert list(log.parent.iterdir()) == []
        return
    entries: list[Entry] = list(read_episode(log).entries())
    end = entries[-1]
    assert isinstance(end, End)
    assert end.result.reason is EndReason(row.log)
    told = None if isinstance(raised, KeyboardInterrupt) else f"{type(raised).__name__}: {raised}"
    assert end.result.error == told
    assert any(isinstance(entry, ArmState) for entry in entries) == (row.arm == "stops")
