"""tdpg-bench: one command for every benchmark."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

BENCHMARKS = {
    "perception": "a D435 frame becomes a heightmap; the renderer",
    "decision": "a heightmap becomes a decision, for each network",
    "primitive": "grasps and pushes in the simulated cell",
    "emulated": "the emulated cell beside the mock cell; the force of a touch",
    "log": "what logging costs; reading a log back",
    "audit": "tdpg-audit and its pages on 200 episodes of 30 steps",
    "calibration": "error of hand-eye calibration beside OpenCV's methods",
}


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-bench",
        description="Measure here and now: median, spread, ratio to a reference of the same run.",
        epilog="benchmarks: " + "; ".join(f"{name}: {what}" for name, what in BENCHMARKS.items()),
    )
    p.add_argument("name", choices=sorted(BENCHMARKS), help="which benchmark to run")
    p.add_argument("--json", metavar="FILE", help="also write the figures there")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    args = parser().parse_args(argv)

    import importlib
    import json
    from dataclasses import asdict
    from pathlib import Path

    from rich.console import Console
    from rich.table import Table

    from tools.benchmark.machine import describe_machine
    from tools.benchmark.measure import Measurement

    console = Console()
    machine = describe_machine()
    console.print(" | ".join(f"{key} {value}" for key, value in machine.items()), style="dim")
    with console.status(f"measuring {args.name}"):
        results: list[Measurement] = importlib.import_module(f"tools.benchmark.{args.name}").run()

    table = Table("what", "median", "spread", "reference", "ratio", "n")
    for m in results:
        table.add_row(
            m.name,
            f"{m.median:.4g} {m.unit}",
            f"{m.low:.4g} to {m.high:.4g}",
            "" if m.reference is None else f"{m.reference:.4g} {m.unit}",
            "" if m.ratio is None else f"{m.ratio:.3g}",
            str(m.repeats),
        )
    console.print(table)
    if args.json:
        report = {"machine": machine, "results": [asdict(m) for m in results]}
        Path(args.json).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
