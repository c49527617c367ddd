"""What `policies` can raise.

PolicyError
├── CheckpointError      the file is not a checkpoint that this version may load
├── HeightmapError       a heightmap's arrays contradict each other
└── NoActionError        no pixel of the heightmap offers an allowed action
"""

from __future__ import annotations


class PolicyError(Exception):
    """Base of everything raised on purpose by `policies`."""


class CheckpointError(PolicyError):
    """The file is missing, truncated, foreign, hostile, altered or from a newer version."""


class HeightmapError(PolicyError, ValueError):
    """Arrays of a heightmap have the wrong shape or type."""


class NoActionError(PolicyError):
    """Nothing is left to try: the map is empty, unknown, or every action was refused."""
