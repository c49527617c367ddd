"""What tdpg-replay does."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

from rich.console import Console

from policies.errors import HeightmapError, PolicyError
from policies.shipped import NamedPolicy, open_policy
from tdpg_deploy.cell_config import CellConfig, load_cell
from tdpg_deploy.episode_log import software
from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.errors import ConfigError, LogError, TdpgError
from tools.replay import telling
from tools.replay.assumptions import parse_offset, with_camera_moved
from tools.replay.divergence import Divergence, Surroundings, first_divergence
from tools.replay.messages_of import sound
from tools.replay.redecide import redecide
from tools.replay.telling import Line
from tools.replay.terminal import Stepper, show_head

SAME, DIVERGED, BAD_INPUT, DAMAGED, STOPPED = 0, 1, 2, 3, 130


def replay(args: argparse.Namespace) -> int:
    """Do what the command line asks for. Returns the exit code."""
    console = Console(highlight=False, emoji=False)
    try:
        return _task(args)(args, read_episode(args.log), console)
    except (TdpgError, PolicyError) as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        return BAD_INPUT
    except KeyboardInterrupt:
        return STOPPED


def _task(args: argparse.Namespace) -> Callable[[argparse.Namespace, Episode, Console], int]:
    if args.reenact:
        return _reenact
    if args.video is not None:
        return _write_video
    if args.rerun or args.rrd is not None:
        return _to_rerun
    if args.foxglove:
        return _to_foxglove
    if args.policy is not None or args.config is not None or args.move_camera is not None:
        return _decide_again
    return _walk


# --- in the terminal --------------------------------------------------------------------------


def _walk(args: argparse.Namespace, episode: Episode, console: Console) -> int:
    episodes = [episode]
    if args.against is not None:
        episodes.append(read_episode(args.against))
    for shown in episodes:
        show_head(console, shown)
    stepper = Stepper(console, first=args.first, wait=args.step)
    stepper.show(*(partial(_told, shown) for shown in episodes))
    return _damage(stepper.damage, console)


def _told(episode: Episode) -> Iterator[list[Line]]:
    return (lines for _, lines in telling.tell_each(episode))


def _damage(damage: list[LogError], console: Console) -> int:
    for error in damage:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
    return DAMAGED if damage else SAME


def _decide_again(args: argparse.Namespace, episode: Episode, console: Console) -> int:
    about = episode.about
    policy = open_policy(args.policy) if args.policy is not None else policy_of(about)
    config = _assumed(args, about.cell)
    again = Surroundings(
        cell=config or about.cell,
        policy=policy.name,
        checkpoint_sha256=policy.sha256,
        commit=software.commit(),
        versions=software.versions(),
    )
    show_head(console, episode)
    told = _Again(episode, policy, config, again)
    stepper = Stepper(console, first=args.first, wait=args.step)
    try:
        stepper.show(told.lines)
    except HeightmapError as error:
        raise ConfigError(
            f"{policy.name} cannot decide on this log, which may be of another task: {error}"
        ) from error
    console.rule(style="dim")
    console.print(told.summary(), markup=False, soft_wrap=True)
    damaged = _damage(stepper.damage, console)
    is_test = config is None and policy.sha256 == about.checkpoint_sha256
    return DIVERGED if is_test and told.diverged() else damaged


@dataclass
class _Again:
    """Steps decided again, as lines; what differed is kept."""

    episode: Episode
    policy: NamedPolicy
    config: CellConfig | None
    surroundings: Surroundings
    steps: int = 0
    found: list[Divergence] = field(default_factory=list)

    def lines(self) -> Iterator[list[Line]]:
        self.steps, self.found = 0, []
        logged = Surroundings.of(self.episode.about)
        for step in redecide(self.episode, self.policy.decider, self.config):
            divergence = first_divergence(step, logged, self.surroundings)
            self.steps += 1
            if divergence is not None:
                self.found.append(divergence)
            yield [*telling.tell(step.step), *telling.tell_again(step, divergence)]

    def diverged(self) -> bool:
        """On another processor, what stays within the tolerance is the same."""
        logged, now = self.episode.about.versions, self.surroundings.versions
        if logged.get("processor") == now.get("processor"):
            return bool(self.found)
        return not all(divergence.within_tolerance for divergence in self.found)

    def summary(self) -> str:
        if not self.found:
            return f"{self.steps} of {self.steps} steps are the same, bit for bit"
        first = self.found[0]
        acts = sum(not divergence.same_action for divergence in self.found)
        return (
            f"{len(self.found)} of {self.steps} steps differ, {acts} of them in what is done. "
            f"First: step {first.number}, {first.stage.value}: {first.found}. "
            f"Cause: {first.cause.value}"
        )


def policy_of(about: About) -> NamedPolicy:
    """The policy that the log names, where it can be found. Raises ConfigError."""
    if about.checkpoint_sha256 is None and about.policy == "random":
        return open_policy("random")
    for goal in (False, True):
        with suppress(PolicyError):
            shipped = open_policy(goal=goal)
            if shipped.sha256 == about.checkpoint_sha256:
                return shipped
    raise ConfigError(
        f"the log's policy {about.policy} (SHA-256 {about.checkpoint_sha256}) is no "
        "shipped one: name its file with --policy"
    )


def _assumed(args: argparse.Namespace, logged: CellConfig) -> CellConfig | None:
    """Another cell than the log's, if one is asked for."""
    if args.config is None and args.move_camera is None:
        return None
    config = logged if args.config is None else load_cell(args.config)
    if args.move_camera is None:
        return config
    return with_camera_moved(config, parse_offset(args.move_camera))


# --- elsewhere --------------------------------------------------------------------------------


def _reenact(args: argparse.Namespace, episode: Episode, console: Console) -> int:
    from tools.replay.reenact import reenact

    show_head(console, episode)
    told = telling.tell_tried(
        reenact(episode, args.first), logged_by=episode.about.commit, commit=software.commit()
    )
    for label, text in told:
        console.print(f"[dim]{label:10s}[/]", end="")
        console.print(text, markup=False, soft_wrap=True)
    return SAME


def _write_video(args: argparse.Namespace, episode: Episode, console: Console) -> int:
    from tools.replay.video import write_video

    damage: list[LogError] = []
    frames = write_video(
        episode, args.video, first=args.first, speed=args.speed, on_damage=damage.append
    )
    console.print(f"{args.video}: {frames} pictures", markup=False, soft_wrap=True)
    return _damage(damage, console)


def _to_rerun(args: argparse.Namespace, episode: Episode, console: Console) -> int:
    from tools.replay.to_rerun import open_in_rerun, write_rrd

    with sound(episode) as (whole, damage):
        if args.rerun:
            open_in_rerun(whole)
        else:
            write_rrd(whole, args.rrd)
            console.print(f"{args.rrd}: open it with rerun", markup=False, soft_wrap=True)
    return _damage(damage, console)


def _to_foxglove(args: argparse.Namespace, episode: Episode, console: Console) -> int:
    from tools.replay.to_foxglove import serve

    with sound(episode) as (whole, damage):
        _damage(damage, console)
        serve(whole, console, speed=args.speed, first=args.first)
    return SAME
