from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from policies.errors import NoActionError
from policies.heightmap import SIZE, Heightmap
from policies.policy import Decision
from policies.primitives import Primitive, Push
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.choosing import Chooser
from tdpg_deploy.outcome import Motion, PushOutcome, Verdict
from tdpg_deploy.workspace import workspace_of

CONFIG = load_cell(DEFAULT_CELL)
PUSH = Push(x=0.5, y=0.0, z=-0.15, yaw=0.0)


class Avoiding:
    """Decides nothing, and notes what it was to avoid first."""

    def __init__(self) -> None:
        self.avoided: list[list[Primitive]] = []

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        self.avoided.append(list(avoid))
        raise NoActionError("nothing")


def looks(*heights: float) -> list[Heightmap]:
    """Tables with one block of each height ahead of the push."""
    maps = []
    for height in heights:
        surface = np.zeros((SIZE, SIZE), np.float32)
        surface[90:110, 100:124] = height
        color = np.zeros((SIZE, SIZE, 3), np.uint8)
        maps.append(Heightmap(workspace=workspace_of(CONFIG), color=color, height=surface))
    return maps


def outcome(contact: str | None, changed: Verdict) -> PushOutcome:
    motion = Motion(contact=contact, seconds=1.0)
    return PushOutcome(motion=motion, travelled=0.0, changed=changed)


@pytest.mark.parametrize(
    ("contact", "changed", "avoided"),
    [
        ("descend", Verdict.YES, [PUSH]),  # it shook what it landed on, and would land there again
        ("lower", Verdict.UNKNOWN, [PUSH]),
        ("push", Verdict.YES, []),
        (None, Verdict.NO, []),  # the looks differ: something else moved
    ],
)
def test_what_ended_on_its_way_down_is_not_tried_again_there(
    contact: str | None, changed: Verdict, avoided: list[Primitive]
) -> None:
    before, after, later = looks(0.05, 0.08, 0.02)
    policy = Avoiding()
    chooser = Chooser(policy, CONFIG, np.random.default_rng(0))
    chooser.learn(PUSH, outcome(contact, changed), before, after)
    assert chooser.choose(after, lambda *_: None) is None
    assert policy.avoided[0] == avoided
    chooser.learn(PUSH, outcome(contact, changed), before, after)
    chooser.learn(PUSH, outcome(None, Verdict.YES), after, later)
    policy.avoided.clear()
    chooser.choose(later, lambda *_: None)
    assert policy.avoided[0] == []
