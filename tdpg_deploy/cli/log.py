"""tdpg-log: is a log whole, what is in it, what can be saved of it, and exports."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tdpg_deploy.errors import LogError

if TYPE_CHECKING:
    from rich.console import Console

    from tdpg_deploy.episode_log.entries import Step
    from tdpg_deploy.episode_log.recover import Report

EPILOG = """\
exit codes: 0 whole; 3 damaged, but part of it can be read; 1 nothing can be read.
Of several files the worst one counts."""


def main(argv: Sequence[str] | None = None) -> int:
    """Returns the exit code."""
    args = _parser().parse_args(argv)
    from rich.console import Console

    console = Console(highlight=False, markup=False)  # of what a log says, none is ours
    try:
        code: int = args.run(args, console)
    except LogError as error:
        print(f"tdpg-log: {error}", file=sys.stderr)  # noqa: T201
        return 1
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tdpg-log",
        description=__doc__.removeprefix("tdpg-log: ") if __doc__ else None,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="command")
    check = commands.add_parser("check", help="read everything, compare every checksum")
    check.add_argument("logs", nargs="+", type=Path, metavar="LOG")
    check.set_defaults(run=_check)
    recover = commands.add_parser("recover", help="copy what can be read into a sound file")
    recover.add_argument("log", type=Path, metavar="LOG")
    recover.add_argument("-o", "--out", type=Path, help="default: NAME.recovered.mcap beside it")
    recover.set_defaults(run=_recover)
    info = commands.add_parser("info", help="what an episode was, and its steps")
    info.add_argument("log", type=Path, metavar="LOG")
    info.set_defaults(run=_info)
    export = commands.add_parser("export", help="logs as a dataset for training")
    export.add_argument("--lerobot", required=True, type=Path, metavar="DIR", help="a new folder")
    export.add_argument("logs", nargs="+", type=Path, metavar="LOG")
    export.set_defaults(run=_export)
    return parser


def _check(args: argparse.Namespace, console: Console) -> int:
    from tdpg_deploy.episode_log.recover import Condition, check

    conditions = set()
    for log in args.logs:
        report = check(log)
        _tell(log, report, console)
        conditions.add(report.condition)
    worst = next(
        c for c in (Condition.NOTHING, Condition.LOSSY, Condition.WHOLE) if c in conditions
    )
    return worst.value


def _recover(args: argparse.Namespace, console: Console) -> int:
    from tdpg_deploy.episode_log.recover import recover

    name = args.log.name.removesuffix(".part").removesuffix(".mcap")
    target = args.out or args.log.with_name(f"{name}.recovered.mcap")
    report = recover(args.log, target)
    _tell(args.log, report, console)
    if report.messages:
        console.print(f"saved as {target}", soft_wrap=True)
    return report.condition.value


def _tell(log: Path, report: Report, console: Console) -> None:
    condition = report.condition.name.lower()
    console.print(f"{log}: {condition}, {report.messages} messages can be read", soft_wrap=True)
    for damage in report.damage:
        console.print(f"  {damage}", soft_wrap=True)


def _export(args: argparse.Namespace, console: Console) -> int:
    try:
        from tdpg_deploy.episode_log.lerobot.dataset import DatasetWriter
    except ModuleNotFoundError as error:
        raise LogError(f"{error.name} is missing: pip install 'tdpg-deploy[audit]'") from error
    from tdpg_deploy.episode_log.lerobot.frames import frames
    from tdpg_deploy.episode_log.reader import read_episode
    from tdpg_deploy.episode_log.recover import Condition

    condition = Condition.WHOLE
    try:
        with DatasetWriter(args.lerobot) as dataset:
            for log in args.logs:
                before = dataset.frames
                try:
                    dataset.add(frames(read_episode(log)))
                except LogError as error:
                    condition = Condition.LOSSY
                    console.print(str(error), style="yellow", soft_wrap=True)
                told = f"{log}: {dataset.frames - before} frames"
                console.print(told, soft_wrap=True)
    except OSError as error:
        raise LogError(f"{args.lerobot}: cannot be written ({error.strerror})") from error
    if not dataset.frames:
        return Condition.NOTHING.value
    console.print(f"{args.lerobot}: {dataset.frames} frames", soft_wrap=True)
    return condition.value


def _info(args: argparse.Namespace, console: Console) -> int:
    from rich.table import Table

    from tdpg_deploy.episode_log.reader import read_episode

    episode = read_episode(args.log)
    about, result = episode.about, episode.result()
    console.print(f"{about.cell.name} cell, policy {about.policy}, seed {about.seed}")
    console.print(f"checkpoint {about.checkpoint_sha256}, commit {about.commit}", soft_wrap=True)
    if result is not None:
        console.print(
            f"ended: {result.reason.value}, {result.actions} actions in {result.seconds:.1f} s, "
            f"grasps {result.grasp_successes}/{result.grasps}, "
            f"pushes {result.push_successes}/{result.pushes}"
        )
    table = Table("step", "action", "q", "refused", "contact", "success")
    damage = None
    try:
        for number, step in enumerate(episode.steps(images=False, states=False), start=1):
            table.add_row(str(number), *_row(step))
    except LogError as error:
        damage = error
    console.print(table)
    if damage is not None:
        console.print(str(damage), soft_wrap=True)
        return 3
    return 0


def _row(step: Step) -> tuple[str, ...]:
    decision = None if step.intent is None else step.intent.decision
    return (
        "none" if decision is None else type(decision.primitive).__name__.lower(),
        "" if decision is None else f"{decision.q:.3f}",
        str(len(step.refusals)),
        "" if step.outcome is None else step.outcome.motion.contact or "",
        "not known" if step.outcome is None else step.outcome.success.value,
    )
