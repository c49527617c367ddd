"""tdpg-train: learn in the simulated cell; resumes by itself where it was killed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

EXPERIMENTS = Path(__file__).parent / "experiments"


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-train",
        description=__doc__,
        epilog="The same command goes on with a run that was interrupted. exit codes: 0 trained; "
        "2 bad input; 130 interrupted, the last round is saved",
    )
    which = p.add_mutually_exclusive_group()
    which.add_argument(
        "--stage", choices=["grasp"], default="grasp", help="the paper's stage, at its budget"
    )
    which.add_argument("--experiment", type=Path, metavar="FILE", help="an experiment's TOML file")
    p.add_argument("--actions", type=int, metavar="N", help="instead of the experiment's")
    p.add_argument("--seed", type=int, metavar="N", help="instead of the experiment's")
    p.add_argument("--workers", type=int, metavar="N", help="processes that play")
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="of this run")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    args = parser().parse_args(argv)

    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    from tdpg_deploy.errors import TdpgError
    from tools.train import trainer
    from tools.train.config import load_train_config, overridden

    console = Console()
    try:
        file = args.experiment or EXPERIMENTS / f"{args.stage}.toml"
        config = overridden(
            load_train_config(file), actions=args.actions, seed=args.seed, workers=args.workers
        )
        with Progress(
            TextColumn("round {task.fields[round]}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("success {task.fields[success]:.2f}  loss {task.fields[loss]:.3f}"),
            TimeRemainingColumn(),
            console=console,
        ) as bar:
            task = bar.add_task("", total=config.actions, round=0, success=0.0, loss=0.0)

            def show(progress: trainer.Progress) -> None:
                bar.update(
                    task,
                    completed=min(progress.actions, config.actions),
                    round=progress.round,
                    success=progress.success,
                    loss=progress.huber,
                )

            policy = trainer.train(config, args.out, on_progress=show)
    except TdpgError as error:
        console.print(str(error), style="red", markup=False)
        return 2
    except KeyboardInterrupt:
        console.print(
            f"interrupted; run the same command to go on from the last round in {args.out}"
        )
        return 130
    console.print(f"policy: {policy}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
