"""What the summary needs of a set of logs, taken from their rows as they come in."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from tools.audit.rows import AuditedLog
from tools.audit.run import Unreadable
from tools.evaluate.metrics import EpisodeRow


@dataclass(kw_only=True)
class Causes:
    """How often each cause was found, and the first evidence of each."""

    counts: Counter[str] = field(default_factory=Counter)
    samples: dict[str, str] = field(default_factory=dict)

    def add(self, cause: str, place: str, evidence: str | None) -> None:
        self.counts[cause] += 1
        self.samples.setdefault(cause, f"{place}: {evidence}")


@dataclass(kw_only=True)
class Tally:
    """rows: of complete logs, for the metrics. failures: of actions that did not succeed, under
    their first cause; ends: of episodes that failed."""

    rows: list[EpisodeRow] = field(default_factory=list)
    unreadable: list[Unreadable] = field(default_factory=list)
    episodes: int = 0
    truncated: int = 0
    actions: int = 0
    failures: Causes = field(default_factory=Causes)
    ends: Causes = field(default_factory=Causes)
    refusals: Counter[str] = field(default_factory=Counter)

    def add(self, log: AuditedLog | Unreadable) -> None:
        if isinstance(log, Unreadable):
            self.unreadable.append(log)
            return
        episode = log.episode
        self.episodes += 1
        if log.row is None:
            self.truncated += 1
        else:
            self.rows.append(log.row)
        if episode.cause is not None:
            self.ends.add(episode.cause, episode.episode, episode.evidence)
        for action in log.actions:
            self.refusals.update(action.refusals)
            if action.kind == "none":
                continue
            self.actions += 1
            if action.cause is not None:
                place = f"{episode.episode} action {action.step}"
                self.failures.add(action.cause, place, action.evidence)
