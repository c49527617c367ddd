"""What an examination finds, and how it is told."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any


class Verdict(Enum):
    GOOD = "good"
    DOUBT = "doubt"  # works, but look at it
    BAD = "bad"  # the cell will not work


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


def as_text(finding: Finding) -> str:
    """For a terminal: one line, and one more with the remedy."""
    line = f"{finding.device:<9}{finding.verdict.value:<7}{finding.check:<16}{finding.measured}"
    return f"{line}\n{'':32}-> {finding.remedy}" if finding.remedy else line


def summary(findings: Sequence[Finding]) -> str:
    counts = {verdict: sum(f.verdict is verdict for f in findings) for verdict in Verdict}
    if counts[Verdict.GOOD] == len(findings):
        return f"all {len(findings)} checks are good"
    return (
        f"{counts[Verdict.BAD]} bad and {counts[Verdict.DOUBT]} doubtful of {len(findings)} checks"
    )


def as_document(cell: str, findings: Sequence[Finding]) -> dict[str, Any]:
    """For --json."""
    return {
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
