"""tdpg-doctor: examine every device of a cell file, moving nothing unless asked to."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

DEVICES = ("arm", "gripper", "camera")
EXIT_CODES = """
exit codes:
  0  nothing is bad
  1  something is bad; how to mend it is said
  2  bad input: arguments, cell file
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-doctor",
        description=__doc__,
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("--config", type=Path, metavar="FILE", help="cell file (default: the mock cell)")
    p.add_argument(
        "--device", choices=DEVICES, action="append", help="only this one; may be repeated"
    )
    p.add_argument(
        "--move",
        action="store_true",
        help="then try small motions, when nothing is bad; asks first",
    )
    p.add_argument("--json", action="store_true", help="findings as one JSON document")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    args = parser().parse_args(argv)

    from rich.console import Console

    from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
    from tdpg_deploy.doctor.examination import Examination, examinations, examine, motions
    from tdpg_deploy.doctor.finding import Finding, as_document, as_line, is_healthy, summary
    from tdpg_deploy.errors import ConfigError

    try:
        config = load_cell(args.config or DEFAULT_CELL)
    except ConfigError as error:
        sys.stderr.write(f"tdpg-doctor: {error}\n")
        return 2
    wanted = args.device or DEVICES
    findings: list[Finding] = []
    console = Console(highlight=False)

    def look(at: Mapping[str, Examination]) -> None:
        device = None
        for finding in examine({device: at[device] for device in at if device in wanted}):
            findings.append(finding)
            if not args.json:  # as it goes: a device may take seconds
                console.print(as_line(finding, names_device=finding.device != device))
            device = finding.device

    look(examinations(config))
    if args.move and is_healthy(findings) and _agreed():
        look(motions(config))
    if args.json:
        print(json.dumps(as_document(config.name, findings), indent=2))  # noqa: T201
    else:
        console.print(summary(findings))
    return 0 if is_healthy(findings) else 1


def _agreed() -> bool:
    """Whether the operator lets the cell move."""
    from tdpg_deploy.doctor.moves import PLAN

    sys.stderr.write(f"{PLAN}\nMove now? [yes/no] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() == "yes"


if __name__ == "__main__":
    sys.exit(main())
