"""tdpg-train: learn in the simulated cell; resumes by itself where it was killed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from tools.train.config import CoordinatorCourse, GraspCourse, PushCourse, TrainConfig
    from tools.train.curve import Progress as Round

EXPERIMENTS = Path(__file__).parent / "experiments"


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-train",
        description=__doc__,
        epilog="Without --stage and --experiment: all stages of the paper, at its budget. "
        "The same command goes on with a run that was interrupted. exit codes: 0 trained; "
        "2 bad input; 130 interrupted, the last round is saved",
    )
    which = p.add_mutually_exclusive_group()
    which.add_argument(
        "--stage", choices=["grasp", "push", "synergy"], help="one of the paper's, at its budget"
    )
    which.add_argument("--experiment", type=Path, metavar="FILE", help="an experiment's TOML file")
    p.add_argument("--from", type=Path, dest="start", metavar="FILE", help="policy to begin with")
    p.add_argument(
        "--imagenet", type=Path, metavar="FILE", help="torchvision's densenet121 to begin with"
    )
    p.add_argument(
        "--pushes",
        type=Path,
        metavar="DIR",
        help="where a course of pushes keeps what it played and taught, for other policies too "
        "(default: --out)",
    )
    p.add_argument(
        "--actions",
        type=int,
        metavar="N",
        help="of each stage, pushes of each round, or grasps, not the experiment's",
    )
    p.add_argument("--seed", type=int, metavar="N", help="instead of the experiment's")
    p.add_argument("--workers", type=int, metavar="N", help="processes that play")
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="of this run")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    args = parser().parse_args(argv)

    from rich.console import Console

    from policies.errors import PolicyError
    from tdpg_deploy.errors import TdpgError
    from tools.train.config import TrainConfig, load_experiment

    console = Console()
    try:
        file = args.experiment or EXPERIMENTS / f"{args.stage or 'tdpg'}.toml"
        experiment = load_experiment(file)
        if isinstance(experiment, TrainConfig):
            policy = _train(experiment, args, console)
        else:
            policy = _teach(experiment, args, console)
    except (TdpgError, PolicyError) as error:
        console.print(str(error), style="red", markup=False)
        return 2
    except KeyboardInterrupt:
        console.print(
            f"interrupted; run the same command to go on from the last round in {args.out}"
        )
        return 130
    console.print(f"policy: {policy}")
    return 0


def _train(config: TrainConfig, args: argparse.Namespace, console: Console) -> Path:
    from tdpg_deploy.errors import ConfigError
    from tools.train import trainer
    from tools.train.config import overridden

    if args.pushes is not None:
        raise ConfigError("--pushes: this experiment is no course of pushes")
    config = overridden(
        config,
        actions=args.actions,
        seed=args.seed,
        workers=args.workers,
        start=args.start,
        imagenet=args.imagenet,
    )
    with _bar(console) as bar:
        task = bar.add_task("first round", total=config.actions)
        judged = None

        def show(done: Round) -> None:
            nonlocal judged
            judged = done.validation or judged
            line = _line(replace(done, validation=judged))
            bar.update(task, completed=done.actions, description=line)

        return trainer.train(config, args.out, on_progress=show)


def _teach(
    course: PushCourse | GraspCourse | CoordinatorCourse,
    args: argparse.Namespace,
    console: Console,
) -> Path:
    from tdpg_deploy.errors import ConfigError
    from tools.train.config import GraspCourse, PushCourse, overridden_course
    from tools.train.coordinate import teach_coordinator
    from tools.train.grasps.course import teach_grasps
    from tools.train.pushes.course import teach_pushes

    if args.imagenet is not None:
        raise ConfigError("--imagenet: a course has no DenseNet-121")
    if args.pushes is not None and not isinstance(course, PushCourse):
        raise ConfigError("--pushes: this experiment is no course of pushes")
    course = overridden_course(
        course, tries=args.actions, seed=args.seed, workers=args.workers, start=args.start
    )
    with _bar(console) as bar:
        task = bar.add_task("begins", total=None)

        def show(what: str, done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, description=what)

        if isinstance(course, PushCourse):
            return teach_pushes(course, args.out, args.pushes or args.out, on_progress=show)
        if isinstance(course, GraspCourse):
            return teach_grasps(course, args.out, on_progress=show)
        return teach_coordinator(course, args.out, on_progress=show)


def _bar(console: Console) -> Progress:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    return Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.description}"),
        TimeRemainingColumn(),
        console=console,
    )


def _line(done: Round) -> str:
    """The live line; "-" where there is no figure."""
    figures = {
        "grasps": done.grasp_success,
        "pushes": done.push_reward,
        "loss": done.huber,
        "validation": None if done.validation is None else done.validation.grasp_success,
    }
    told = (f"{name} {'-' if x is None else format(x, '.2f')}" for name, x in figures.items())
    return f"round {done.round}, {done.stage}: " + "  ".join(told)


if __name__ == "__main__":
    sys.exit(main())
