"""tdpg-eval: how good a policy is, by the paper's metrics, from the logs of seeded episodes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-eval",
        description=__doc__,
        epilog="Policies meet the same tables: pairs of runs differ in nothing but the policy. "
        "The same command goes on with an evaluation that was interrupted.",
    )
    p.add_argument(
        "--policy",
        action="append",
        metavar="FILE",
        help='a checkpoint, or "random"; may be given more than once (default: a shipped one)',
    )
    p.add_argument("--goal", action="store_true", help="fetch one object instead of clearing all")
    p.add_argument("--episodes", type=int, default=30, metavar="N", help="of each table")
    p.add_argument("--seed", type=int, default=10_000, metavar="N", help="of the first episode")
    p.add_argument("--config", type=Path, metavar="FILE", help="cell file (default: the mock cell)")
    p.add_argument("--workers", type=int, default=2, metavar="N", help="processes")
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="for logs and figures")

    tables = p.add_argument_group(
        "the tables",
        "Without any of these the paper's: random 15, 20, 25 and 30, the cases, 10 novel objects; "
        "with --goal random 30 and the cases.",
    )
    tables.add_argument("--objects", type=int, nargs="+", default=[], metavar="N", help="random")
    tables.add_argument("--cases", action="store_true", help="the nine challenge cases")
    tables.add_argument(
        "--novel", type=int, nargs="+", default=[], metavar="N", help="objects never trained on"
    )
    tables.add_argument(
        "--scene", type=Path, nargs="+", default=[], metavar="FILE", help="scene files"
    )
    tables.add_argument(
        "--logs",
        type=Path,
        nargs="+",
        default=[],
        metavar="LOG",
        help="play nothing: judge these logs, of a real cell too",
    )
    return p


def main(argv: Sequence[str] | None = None) -> int:
    args = parser().parse_args(argv)

    from rich.console import Console

    from policies.errors import PolicyError
    from tdpg_deploy.errors import TdpgError
    from tools.evaluate.report import evaluate_policies

    console = Console()
    try:
        evaluate_policies(args, console)
    except (TdpgError, PolicyError) as error:
        console.print(str(error), style="red", markup=False)
        return 2
    except KeyboardInterrupt:
        console.print("stopped; the same command goes on")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
