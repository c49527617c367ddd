"""What a person is shown before an arm moves."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from policies.policy import Decision, QMaps
from policies.primitives import Push
from tdpg_deploy.cli.live import Live, describe, describe_step
from tdpg_deploy.geometry import top_down
from tdpg_deploy.plan import MoveFingers, MoveJoints, MoveLinear, Plan

ABOVE = MoveJoints(
    name="above", q=np.radians([90, -80, 100, -110, -90, 0]), speed=0.26, acceleration=1
)
DESCEND = MoveLinear(
    name="descend",
    X_base_tool=top_down(0.5, -0.1, -0.146, 0.0),
    speed=0.0125,
    acceleration=1.0,
    stop_force=15.0,
)
CLOSE = MoveFingers(name="close", width=0.0, speed=0.1, force=20.0)
PUSH = Push(x=0.5, y=-0.1, z=-0.15, yaw=0.0, length=0.1)
PLAN = Plan(primitive=PUSH, approach=(ABOVE, CLOSE, DESCEND), notes=("push shortened",))


def push(*, p_foreseen: float | None = None) -> Decision:
    return Decision(
        primitive=PUSH,
        rotation=0,
        row=0,
        col=0,
        q=0.7,
        maps=QMaps(grasp=np.zeros((1, 1, 1), np.float32), push=np.zeros((1, 1, 1), np.float32)),
        verdict=None,
        seconds={},
        p_foreseen=p_foreseen,
    )


def test_an_action_is_told_with_what_was_foreseen_of_it() -> None:
    assert describe(push()) == "push  at (0.500, -0.100) m  q  0.70"
    assert describe(push(p_foreseen=0.97)) == "push  at (0.500, -0.100) m  q  0.70  foreseen  97%"


def test_a_step_is_told_in_a_line() -> None:
    assert (
        describe_step(ABOVE)
        == "  above         joints at 90, -80, 100, -110, -90, 0 deg, 0.26 rad/s"
    )
    assert describe_step(CLOSE) == "  close         pads 0 mm apart, at most 20 N"
    assert describe_step(DESCEND) == (
        "  descend       tool at 0.500, -0.100, -0.146 m, 0.0125 m/s, stops above 15 N"
    )


@pytest.mark.parametrize(("answer", "agreed"), [("y", True), ("", False), ("n", False)])
def test_the_plan_is_shown_and_the_first_action_asked_for(
    answer: str, agreed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("builtins.input", lambda *_: answer)
    page = io.StringIO()
    live = Live(Console(file=page, width=120), objects=None)
    decision = push()
    assert live.confirm_first(decision, PLAN) == agreed
    shown = page.getvalue()
    assert shown.index("push shortened") < shown.index("above") < shown.index("descend")
    live.intends(decision)
    assert live.confirm_first(decision, PLAN)
    assert page.getvalue().count("descend") == 1
