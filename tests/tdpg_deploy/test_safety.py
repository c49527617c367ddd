"""The gate: each rule, broken alone, with the message an operator reads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from policies.primitives import Grasp, Push
from tdpg_deploy import kinematics
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.errors import PlanRefused
from tdpg_deploy.geometry import Array, Transform, top_down
from tdpg_deploy.plan import MoveFingers, MoveJoints, MoveLinear, Plan, Step
from tdpg_deploy.safety import check, check_steps

CONFIG = load_cell(DEFAULT_CELL)
LIMITS = CONFIG.limits
TABLE_Z = CONFIG.workspace.table_z
TRAVEL_Z = TABLE_Z + LIMITS.travel_height
X_FLANGE_TOOL = CONFIG.arm.X_flange_tool.transform()
HOME: Array = np.array(CONFIG.arm.home)


def joints_at(X_base_tool: Transform) -> Array:
    flange = (X_base_tool @ X_FLANGE_TOOL.inverse()).as_matrix()
    dh = CONFIG.arm.dh
    branches = kinematics.inverse_batch(dh, flange)[[kinematics.branch_of(dh, HOME)]]
    q = kinematics.nearest(branches, HOME, LIMITS.joint_range)
    assert q is not None
    return q


def to_joints(q: Array, name: str = "above") -> MoveJoints:
    return MoveJoints(
        name=name, q=q, speed=LIMITS.joint_speed, acceleration=LIMITS.joint_acceleration
    )


def to_line(x: float, y: float, z: float, *, force: float | None = 15.0) -> MoveLinear:
    return MoveLinear(
        name="descend",
        X_base_tool=top_down(x, y, z, 0.0),
        speed=LIMITS.contact_speed,
        acceleration=LIMITS.acceleration,
        stop_force=force,
    )


ABOVE = to_joints(joints_at(top_down(0.5, 0.0, TRAVEL_Z, 0.0)))
HOMEWARD = to_joints(HOME, "home")
FINGERS = MoveFingers(name="open", width=0.085, speed=0.1, force=20.0)
LOW = to_line(0.5, 0.0, TABLE_Z + 0.01)
UP = to_line(0.5, 0.0, TRAVEL_Z)
GOOD: tuple[Step, ...] = (FINGERS, ABOVE, LOW, UP, HOMEWARD)


def refused(*steps: Step) -> str:
    with pytest.raises(PlanRefused) as refusal:
        check_steps(steps, HOME, CONFIG)
    return str(refusal.value)


def test_a_good_sequence_passes_and_ends_at_home() -> None:
    np.testing.assert_allclose(check_steps(GOOD, HOME, CONFIG), HOME)


# --- numbers ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (replace(ABOVE, speed=3.0), 'waypoint 0 "above" has speed 3.0 rad/s'),
        (replace(ABOVE, acceleration=float("nan")), "has acceleration nan rad/s^2"),
        (replace(ABOVE, q=np.full(6, np.nan)), "six finite angles"),
        (replace(ABOVE, q=np.zeros(5)), "six finite angles"),
        (replace(UP, speed=0.6), "has speed 0.6 m/s, outside"),
        (replace(UP, acceleration=9.0), "has acceleration 9.0 m/s^2"),
        (replace(UP, stop_force=80.0), "has stop force 80.0 N"),
        (replace(FINGERS, width=-0.01), "has width -0.01 m"),
        (replace(FINGERS, force=500.0), "has force 500.0 N"),
        (replace(FINGERS, speed=0.2), "has speed 0.2 m/s"),
    ],
)
def test_numbers_out_of_limits(step: Step, message: str) -> None:
    assert message in refused(step)


def test_standstill_is_no_speed() -> None:
    assert "has speed 0.0" in refused(replace(ABOVE, speed=0.0))


# --- places -----------------------------------------------------------------------------------


def test_outside_of_the_workspace_names_waypoint_place_and_remedy() -> None:
    over = to_joints(joints_at(top_down(0.73, 0.02, TRAVEL_Z, 0.0)))
    down = to_line(0.73, 0.02, -0.04)
    message = refused(FINGERS, over, down)
    assert message.startswith('waypoint 2 "descend" (0.730, 0.020, ')
    assert "lies outside the workspace x [0.276, 0.724]" in message
    assert message.endswith("check X_base_camera")


def test_too_close_to_the_table() -> None:
    message = refused(ABOVE, to_line(0.5, 0.0, TABLE_Z + 0.002))
    assert "is lower over the table than z -0.146 m" in message


def test_joint_motion_may_not_dive_over_the_table() -> None:
    low = joints_at(top_down(0.5, 0.0, TABLE_Z + 0.05, 0.0))
    assert "is lower over the table than z 0.060 m" in refused(ABOVE, to_joints(low))


def test_below_travel_height_a_line_needs_a_force_guard() -> None:
    message = refused(ABOVE, to_line(0.5, 0.0, TABLE_Z + 0.05, force=None))
    assert message == 'waypoint 1 "descend" goes below travel height z 0.100 m without stop_force'


def test_release_over_the_bin_passes_but_not_below() -> None:
    x, y, z = CONFIG.bin.position
    check_steps([ABOVE, to_joints(joints_at(top_down(x, y, z, 0.0)), "bin")], HOME, CONFIG)
    below = to_joints(joints_at(top_down(x, y, z - 0.05, 0.0)), "bin")
    assert "outside the workspace" in refused(ABOVE, below)


# --- the arm ----------------------------------------------------------------------------------


def test_leaving_the_arms_reach_on_the_way() -> None:
    message = refused(ABOVE, to_line(1.2, 0.0, TRAVEL_Z))
    assert "the path leaves the arm's reach at (0.8" in message


def test_joint_range() -> None:
    q = ABOVE.q + np.array([0, 0, 0, 0, 0, 2.8 * np.pi])
    assert 'waypoint 0 "above" turns joint 5 to' in refused(to_joints(q))


def test_passing_a_shoulder_singularity() -> None:
    """Straight over the base, close by its axis: joint 0 would have to whirl."""
    left = to_joints(joints_at(top_down(0.12, -0.25, 0.35, 0.0)))
    fast = replace(to_line(0.12, 0.25, 0.35), speed=LIMITS.travel_speed)
    message = refused(left, fast)
    assert "rad/s, more than 3.14: the arm passes a singularity" in message


def test_low_elbow() -> None:
    message = refused(to_joints(np.deg2rad([90.0, 20.0, 0.0, -80.0, -90.0, 0.0])))
    assert "brings the elbow to" in message


# --- plans ------------------------------------------------------------------------------------


def test_both_ways_through_a_plan_are_checked() -> None:
    grasp = Grasp(x=0.5, y=0.0, z=TABLE_Z, yaw=0.0)
    x, y, z = CONFIG.bin.position
    at_bin = to_joints(joints_at(top_down(x, y, z, 0.0)), "bin")
    check(Plan(primitive=grasp, approach=GOOD[:-1], delivery=(at_bin,), retreat=GOOD[-1:]), CONFIG)
    bad = replace(at_bin, speed=9.0)
    with pytest.raises(PlanRefused, match='waypoint 4 "bin" has speed'):
        check(Plan(primitive=grasp, approach=GOOD[:-1], delivery=(bad,), retreat=()), CONFIG)
    push = Push(x=0.5, y=0.0, z=TABLE_Z, yaw=0.0)
    homeward = replace(HOMEWARD, speed=9.0)
    with pytest.raises(PlanRefused, match='waypoint 4 "home" has speed'):
        check(Plan(primitive=push, approach=GOOD[:-1], retreat=(homeward,)), CONFIG)
