"""Policies by name: what is shipped, a checkpoint's path, or a baseline."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

from policies.baselines import RandomPolicy
from policies.checkpoint import load_checkpoint
from policies.policy import Decider

# In weights/, each with its card beside it.
CLEAR = "clear-tried.safetensors"
FETCH = "fetch-foreseen.safetensors"


@dataclass(frozen=True, kw_only=True)
class NamedPolicy:
    """sha256: of the checkpoint; None for a policy without weights."""

    name: str
    decider: Decider
    sha256: str | None


def open_policy(name: str | None = None, *, goal: bool = False) -> NamedPolicy:
    """A shipped policy (None), "random", or a checkpoint's path. Raises CheckpointError.

    goal: of the two that are shipped, the one that fetches.
    """
    if name is None:
        with as_file(files("policies") / "weights" / (FETCH if goal else CLEAR)) as path:
            return open_policy(str(path))
    if name == "random":
        return NamedPolicy(name=name, decider=RandomPolicy(), sha256=None)
    checkpoint = load_checkpoint(Path(name))
    return NamedPolicy(name=Path(name).name, decider=checkpoint.policy(), sha256=checkpoint.sha256)
