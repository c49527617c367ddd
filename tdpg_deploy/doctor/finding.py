"""What an examination finds, and how it is told."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from rich.table import Table
from rich.text import Text

DOCUMENT_VERSION = 1  # of --json: grows when a field changes its meaning or goes


class Verdict(Enum):
    GOOD = "good"
    DOUBT = "doubt"  # works, but look at it
    BAD = "bad"  # the cell will not work


STYLES = {Verdict.GOOD: "green", Verdict.DOUBT: "yellow", Verdict.BAD: "bold red"}


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One check of one device: what was measured, and how to mend it unless it is good."""

    device: str
    check: str
    verdict: Verdict
    measured: str
    remedy: str = ""


def judge(
    device: str, check: str, measured: str, *, good: bool, remedy: str, bad: bool = False
) -> Finding:
    """Good, else bad when `bad`, else in doubt; the remedy is told unless it is good."""
    if good:
        return Finding(device=device, check=check, verdict=Verdict.GOOD, measured=measured)
    verdict = Verdict.BAD if bad else Verdict.DOUBT
    return Finding(device=device, check=check, verdict=verdict, measured=measured, remedy=remedy)


def as_line(finding: Finding, *, names_device: bool) -> Table:
    """For a terminal of any width; below what was measured stands how to mend it."""
    style = STYLES[finding.verdict]
    line = Table.grid(padding=(0, 2, 0, 0), expand=True)
    for width in (8, 6, 15):
        line.add_column(width=width)
    line.add_column(ratio=1)
    line.add_row(
        Text(finding.device if names_device else "", style="bold"),
        Text(finding.verdict.value, style=style),
        Text(finding.check),
        Text(finding.measured),
    )
    if finding.remedy:
        line.add_row("", "", "", Text(f"-> {finding.remedy}", style=style))
    return line


def summary(findings: Sequence[Finding]) -> str:
    counts = {verdict: sum(f.verdict is verdict for f in findings) for verdict in Verdict}
    if counts[Verdict.GOOD] == len(findings):
        return f"all {len(findings)} checks are good"
    return (
        f"{counts[Verdict.BAD]} bad and {counts[Verdict.DOUBT]} doubtful of {len(findings)} checks"
    )


def as_document(cell: str, findings: Sequence[Finding]) -> dict[str, Any]:
    """For --json; docs/doctor.md describes it."""
    return {
        "format": "tdpg-doctor",
        "version": DOCUMENT_VERSION,
        "cell": cell,
        "healthy": is_healthy(findings),
        "findings": [
            {
                "device": finding.device,
                "check": finding.check,
                "verdict": finding.verdict.value,
                "measured": finding.measured,
                "remedy": finding.remedy,
            }
            for finding in findings
        ],
    }


def is_healthy(findings: Iterable[Finding]) -> bool:
    return all(finding.verdict is not Verdict.BAD for finding in findings)
