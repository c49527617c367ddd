"""TDPG and its predecessors as configurations of the same parts."""

from __future__ import annotations

from dataclasses import dataclass

from policies.errors import PolicyError


@dataclass(frozen=True, kw_only=True)
class Method:
    """pushes: both maps are valued. doubts: Critic II may swap push and grasp."""

    name: str
    pushes: bool
    doubts: bool


# At decision time VPG and TDPG-base differ in nothing but how they were trained.
METHODS = {
    method.name: method
    for method in (
        Method(name="grasp-only", pushes=False, doubts=False),
        Method(name="vpg", pushes=True, doubts=False),
        Method(name="vpg+critic", pushes=True, doubts=True),
        Method(name="tdpg-base", pushes=True, doubts=False),
        Method(name="tdpg", pushes=True, doubts=True),
    )
}


def method(name: str) -> Method:
    """By name. Raises PolicyError."""
    if name not in METHODS:
        raise PolicyError(f"method {name!r} is unknown; known are {', '.join(METHODS)}")
    return METHODS[name]
