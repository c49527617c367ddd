"""What logging costs an episode, and reading a log back; beside the mcap package's own reader."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.reader import make_reader

from tdpg_deploy.episode_log.entries import Look
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.episode_log.recover import check, recover
from tdpg_deploy.episode_log.writer import EpisodeWriter
from tdpg_deploy.hal import ArmState
from tools.benchmark.logged_episodes import simulate
from tools.benchmark.measure import Measurement, timed

STEPS, REPEATS = 10, 10


def run() -> list[Measurement]:
    """Milliseconds."""
    with TemporaryDirectory(prefix="tdpg-bench-") as name:
        folder = Path(name)
        [log] = simulate(folder, episodes=1, actions=STEPS)
        episode = read_episode(log)
        steps = sum(1 for _ in episode.steps(images=False))
        size = log.stat().st_size / steps / 1e6
        reference = timed("all messages, by the mcap package", partial(_all, log), repeats=REPEATS)
        return [
            Measurement(name=f"a log of {steps} steps, of each", unit="MB",
                        median=size, low=size, high=size, repeats=1),
            *_writing(episode, folder),
            reference,
            *(
                timed(what, call, repeats=REPEATS, reference=reference.median)
                for what, call in _readings(episode, log, folder).items()
            ),
        ]  # fmt: skip


def _all(log: Path) -> None:
    with log.open("rb") as file:
        for _ in make_reader(file).iter_messages(log_time_order=False):
            pass


def _writing(episode: Episode, folder: Path) -> list[Measurement]:
    entries = list(episode.entries())
    look = next(entry for entry in entries if isinstance(entry, Look))
    state = next(entry for entry in entries if isinstance(entry, ArmState))
    with EpisodeWriter(folder / "again.mcap", episode.about, now=lambda: 0.0) as writer:
        observe = partial(writer.observe, look.frame, look.heightmap)
        return [
            timed("a look is logged", observe, repeats=3 * REPEATS),
            timed("an arm state is logged", partial(writer.arm_state, state), repeats=500),
        ]


def _readings(episode: Episode, log: Path, folder: Path) -> dict[str, Callable[[], object]]:
    numbers = count()
    return {
        "all entries": lambda: list(episode.entries()),
        "steps without images": lambda: list(episode.steps(images=False)),
        "documents alone": lambda: list(episode.steps(images=False, states=False)),
        "check": lambda: check(log),
        "recover": lambda: recover(log, folder / f"saved{next(numbers)}.mcap"),
    }
