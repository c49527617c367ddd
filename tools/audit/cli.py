"""tdpg-audit: what failed in a folder of logs, why, and how two sets compare."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from tdpg_deploy.arguments import positive

EPILOG = """\
tables for --sql: episodes, actions; docs/audit.md lists their columns.
  tdpg-audit logs --sql "SELECT cause, count(*) FROM actions GROUP BY 1 ORDER BY 2 DESC"

exit codes: 0 all logs were read; 3 some files are not logs of ours; 2 bad input"""

READ, PARTLY, BAD_INPUT = 0, 3, 2


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-audit",
        description=__doc__.removeprefix("tdpg-audit: ") if __doc__ else None,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("logs", type=Path, metavar="DIR", help="logs, in it or below")
    p.add_argument("--out", type=Path, metavar="DIR", help="for episodes.parquet, actions.parquet")
    p.add_argument("--sql", metavar="QUERY", help="ask the tables, by DuckDB")
    p.add_argument("--compare", type=Path, metavar="DIR", help="a second set: what changed?")
    p.add_argument("--html", type=Path, metavar="DIR", help="write pages to look through")
    p.add_argument("--serve", action="store_true", help="and serve them on this machine only")
    p.add_argument("--port", type=int, default=8040, metavar="N", help="of --serve (default: 8040)")
    p.add_argument(
        "--workers",
        type=positive,
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes (default: one a core)",
    )
    p.add_argument(
        "--engine",
        choices=["processes", "ray"],
        default="processes",
        help="who runs them (default: processes of this machine)",
    )
    return p


def main(argv: Sequence[str] | None = None) -> int:
    """Returns the exit code."""
    args = parser().parse_args(argv)

    from rich.console import Console

    from tdpg_deploy.errors import TdpgError
    from tools.audit.audit import audit  # heavy: not for --help

    console = Console(highlight=False, emoji=False)
    try:
        complete = audit(args, console)
    except TdpgError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        return BAD_INPUT
    return READ if complete else PARTLY


if __name__ == "__main__":
    sys.exit(main())
