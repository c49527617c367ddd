from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from policies.gripper import CLOSED_GRIPPER, OPEN_GRIPPER, OPEN_WIDTH, Part
from policies.heightmap import SIZE, Heightmap, Workspace
from policies.primitives import Grasp, Push
from tdpg_deploy import kinematics
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.errors import PlanRefused
from tdpg_deploy.footprint import rectangles
from tdpg_deploy.geometry import Transform, top_down
from tdpg_deploy.motion import (
    TOUCH_MARGIN,
    plan_homing,
    plan_primitive,
    room_ahead,
)
from tdpg_deploy.plan import MoveFingers, MoveJoints, MoveLinear, Plan
from tdpg_deploy.safety import check

PADS, BARS, PALM = OPEN_GRIPPER
CONFIG = load_cell(DEFAULT_CELL)
TABLE_Z = CONFIG.workspace.table_z
WORKSPACE = Workspace(
    x_min=CONFIG.workspace.x_range[0], y_min=CONFIG.workspace.y_range[0], table_z=TABLE_Z
)
X_FLANGE_TOOL = CONFIG.arm.X_flange_tool.transform()

inside_x = st.floats(WORKSPACE.x_min + 0.001, WORKSPACE.x_max - 0.001)
inside_y = st.floats(WORKSPACE.y_min + 0.001, WORKSPACE.y_max - 0.001)
yaws = st.integers(0, 15).map(lambda k: k * np.pi / 8)


def table(height: float = 0.0) -> Heightmap:
    return Heightmap(
        workspace=WORKSPACE,
        color=np.zeros((SIZE, SIZE, 3), np.uint8),
        height=np.full((SIZE, SIZE), height, np.float32),
    )


def names(plan: Plan) -> list[list[str]]:
    return [[step.name for step in steps] for steps in (plan.approach, plan.delivery, plan.retreat)]


def linear(plan: Plan, name: str) -> MoveLinear:
    (step,) = [step for step in plan.approach if step.name == name]
    assert isinstance(step, MoveLinear)
    return step


def joints(plan: Plan, name: str) -> MoveJoints:
    (step,) = [step for step in (*plan.approach, *plan.delivery) if step.name == name]
    assert isinstance(step, MoveJoints)
    return step


# --- grasp ------------------------------------------------------------------------------------


def test_grasp_goes_above_down_closes_lifts_delivers_and_returns() -> None:
    plan = plan_primitive(Grasp(x=0.5, y=0.1, z=TABLE_Z + 0.05, yaw=0.3), table(), CONFIG)
    assert names(plan) == [
        ["open", "above", "lower", "descend", "close", "lift"],
        ["over the bin", "release"],
        ["home"],
    ]
    opening, closing = plan.approach[0], plan.approach[4]
    assert isinstance(opening, MoveFingers)
    assert isinstance(closing, MoveFingers)
    assert (opening.width, closing.width) == (OPEN_WIDTH, 0.0)
    assert closing.force == CONFIG.gripper.force
    descend = linear(plan, "descend")
    assert descend.stop_force == CONFIG.limits.descend_force


def test_a_descent_is_slow_from_above_what_is_seen_under_the_fingers() -> None:
    grasp = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.05, yaw=0.0)
    seen = table()
    row, col = WORKSPACE.to_pixel(grasp.x, grasp.y)
    seen.height[row - 5 : row + 5, col - 5 : col + 5] = 0.05  # between the fingers
    for ground in (0.0, 0.03):
        row, col = WORKSPACE.to_pixel(rectangles(PADS, grasp)[1].x, 0.0)
        seen.height[row - 2 : row + 2, col - 2 : col + 2] = ground
        plan = plan_primitive(grasp, seen, CONFIG)
        check(plan, CONFIG)
        lower, descend = linear(plan, "lower"), linear(plan, "descend")
        assert lower.X_base_tool.translation[2] == pytest.approx(TABLE_Z + ground + TOUCH_MARGIN)
        assert (lower.speed, descend.speed) == (0.15, 0.05)
        assert lower.stop_force == descend.stop_force == CONFIG.limits.descend_force
        np.testing.assert_array_equal(
            lower.X_base_tool.translation[:2], descend.X_base_tool.translation[:2]
        )


def test_a_descent_that_ends_far_above_all_that_is_seen_is_not_slow() -> None:
    plan = plan_primitive(Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.10, yaw=0.0), table(), CONFIG)
    assert "lower" not in names(plan)[0]
    assert linear(plan, "descend").speed == CONFIG.limits.contact_speed


def test_a_descent_beside_what_reaches_travel_height_is_slow_all_the_way() -> None:
    high = CONFIG.limits.travel_height - TOUCH_MARGIN / 2
    plan = plan_primitive(Push(x=0.45, y=0.0, z=TABLE_Z, yaw=0.0), table(high), CONFIG)
    assert "lower" not in names(plan)[0]
    assert linear(plan, "descend").speed == CONFIG.limits.touch_speed


def test_a_cell_that_is_slow_anyway_descends_in_one_motion() -> None:
    slow = CONFIG.limits.model_copy(update={"contact_speed": 0.04})
    config = CONFIG.model_copy(update={"limits": slow})
    plan = plan_primitive(Push(x=0.45, y=0.0, z=TABLE_Z, yaw=0.0), table(), config)
    assert "lower" not in names(plan)[0]
    assert linear(plan, "descend").speed == 0.04


@pytest.mark.parametrize(
    ("surface", "tips"), [(0.10, 0.06), (0.05, 0.01), (0.025, 0.004), (0.0, 0.004)]
)
def test_grasp_reaches_below_the_surface_but_clear_of_the_table(
    surface: float, tips: float
) -> None:
    plan = plan_primitive(Grasp(x=0.5, y=0.0, z=TABLE_Z + surface, yaw=0.0), table(), CONFIG)
    assert linear(plan, "descend").X_base_tool.translation[2] == pytest.approx(TABLE_Z + tips)


@given(inside_x, inside_y, yaws)
def test_above_is_straight_over_the_grasp_with_the_closing_direction_asked_for(
    x: float, y: float, yaw: float
) -> None:
    plan = plan_primitive(Grasp(x=x, y=y, z=TABLE_Z + 0.05, yaw=yaw), table(), CONFIG)
    above = kinematics.forward(kinematics.UR5, joints(plan, "above").q, X_FLANGE_TOOL)
    travel_z = TABLE_Z + CONFIG.limits.travel_height
    np.testing.assert_allclose(above.translation, [x, y, travel_z], atol=1e-9)
    tool = above.rotation.as_matrix()
    np.testing.assert_allclose(tool[:, 2], [0, 0, -1], atol=1e-9)
    closing = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    assert abs(tool[:, 0] @ closing) == pytest.approx(1.0)
    assert linear(plan, "descend").X_base_tool.distance(above)[1] < 1e-6
    bin_ = kinematics.forward(
        kinematics.UR5, joints(plan, "over the bin").q, X_FLANGE_TOOL
    ).translation
    np.testing.assert_allclose(bin_, CONFIG.bin.position, atol=1e-9)


@given(inside_x, inside_y, yaws)
def test_every_grasp_in_the_workspace_passes_the_gate(x: float, y: float, yaw: float) -> None:
    check(plan_primitive(Grasp(x=x, y=y, z=TABLE_Z + 0.03, yaw=yaw), table(), CONFIG), CONFIG)


def test_gripper_symmetry_saves_half_a_turn() -> None:
    home = np.array(CONFIG.arm.home)
    for yaw in np.arange(16) * np.pi / 8:
        plan = plan_primitive(Grasp(x=0.5, y=0.0, z=TABLE_Z, yaw=float(yaw)), table(), CONFIG)
        assert abs(joints(plan, "above").q[5] - home[5]) < np.deg2rad(115)


def test_footprints_stand_outside_of_the_opening_on_both_sides() -> None:
    first, second = rectangles(PADS, Grasp(x=0.5, y=0.0, z=0.0, yaw=np.pi / 2))
    assert first.x == pytest.approx(second.x) == pytest.approx(0.5)
    assert first.y == pytest.approx(-second.y)
    assert first.y - first.along / 2 == pytest.approx(OPEN_WIDTH / 2)
    assert first.across == pytest.approx(0.022 + 2 * 0.002)  # a pad, and to spare


def test_grasp_is_refused_where_a_finger_would_meet_the_unknown() -> None:
    seen = table()
    grasp = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.05, yaw=0.0)
    finger = rectangles(PADS, grasp)[0]
    row, col = WORKSPACE.to_pixel(finger.x, finger.y)
    seen.height[row - 3 : row + 4, col - 3 : col + 4] = np.nan
    with pytest.raises(PlanRefused, match=r"under a finger at \(0.552, 0.000\) m is unknown"):
        plan_primitive(grasp, seen, CONFIG)
    turned = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.05, yaw=np.pi / 2)
    plan_primitive(turned, seen, CONFIG)


def test_a_stray_lost_pixel_does_not_forbid_a_grasp() -> None:
    seen = table()
    grasp = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.05, yaw=0.0)
    row, col = WORKSPACE.to_pixel(rectangles(PADS, grasp)[0].x, 0.0)
    seen.height[row, col] = np.nan
    plan_primitive(grasp, seen, CONFIG)


def test_a_grasp_is_refused_where_a_finger_would_land_on_a_neighbour() -> None:
    seen = table()
    grasp = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.05, yaw=0.0)
    row, col = WORKSPACE.to_pixel(rectangles(PADS, grasp)[0].x, 0.0)
    seen.height[row - 5 : row + 6, col - 6 : col + 7] = 0.04
    with pytest.raises(
        PlanRefused, match=r"tips 0\.040 m above the table, beside a surface of 0\.050 m"
    ):
        plan_primitive(grasp, seen, CONFIG)


def test_a_grasp_stays_above_a_lower_neighbour() -> None:
    seen = table()
    grasp = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.06, yaw=0.0)
    row, col = WORKSPACE.to_pixel(rectangles(PADS, grasp)[1].x, 0.0)
    seen.height[row - 5 : row + 6, col - 6 : col + 7] = 0.03
    descend = linear(plan_primitive(grasp, seen, CONFIG), "descend")
    tips = TABLE_Z + 0.03 + CONFIG.limits.table_clearance
    assert descend.X_base_tool.translation[2] == pytest.approx(tips)


@pytest.mark.parametrize(
    ("part", "x", "y", "rows", "cols"),
    [(BARS, 0.568, 0.0, 1, 5), (PALM, 0.5, 0.024, 12, 4)],
    ids=["bar", "palm"],
)
def test_what_carries_the_fingers_stays_above_a_taller_neighbour(
    part: Part, x: float, y: float, rows: int, cols: int
) -> None:
    grasp = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.05, yaw=0.0)
    seen = table()
    row, col = WORKSPACE.to_pixel(x, y)
    tall = seen.height[row - rows : row + rows + 1, col - cols : col + cols + 1]
    tall[:] = part.rise + 0.02
    descend = linear(plan_primitive(grasp, seen, CONFIG), "descend")
    tips = TABLE_Z + 0.02 + CONFIG.limits.table_clearance
    assert descend.X_base_tool.translation[2] == pytest.approx(tips, abs=1e-6)
    tall[:] = part.rise + 0.04
    with pytest.raises(PlanRefused, match=r"tips 0\.040 m above the table"):
        plan_primitive(grasp, seen, CONFIG)


def test_an_unknown_surface_is_refused() -> None:
    with pytest.raises(PlanRefused, match="no surface was seen"):
        plan_primitive(Grasp(x=0.5, y=0.0, z=float("nan"), yaw=0.0), table(), CONFIG)


# --- push -------------------------------------------------------------------------------------


def test_push_goes_down_beside_and_travels_broadside() -> None:
    push = Push(x=0.45, y=0.05, z=TABLE_Z, yaw=np.pi / 4, length=0.1)
    plan = plan_primitive(push, table(), CONFIG)
    assert names(plan) == [
        ["close", "above", "lower", "descend", "push", "back", "lift"],
        [],
        ["home"],
    ]
    down, travel, back = (linear(plan, name).X_base_tool for name in ("descend", "push", "back"))
    way = travel.translation - down.translation
    np.testing.assert_allclose(
        way, [0.1 * np.cos(np.pi / 4), 0.1 * np.sin(np.pi / 4), 0.0], atol=1e-9
    )
    np.testing.assert_allclose(back.translation, down.translation + 0.85 * way, atol=1e-9)
    assert abs(travel.rotation.as_matrix()[:, 0] @ way) < 1e-9
    assert linear(plan, "push").stop_force == CONFIG.limits.push_force
    assert not plan.notes
    check(plan, CONFIG)


def test_push_runs_just_above_what_it_comes_down_on() -> None:
    clearance = CONFIG.limits.table_clearance
    seen = table(0.001)
    push = Push(x=0.45, y=0.0, z=TABLE_Z, yaw=0.0)
    row, col = WORKSPACE.to_pixel(0.52, 0.0)
    seen.height[row - 5 : row + 5, col - 12 : col + 12] = 0.05  # the object ahead does not count
    z = linear(plan_primitive(push, seen, CONFIG), "push").X_base_tool.translation[2]
    assert z == pytest.approx(TABLE_Z + 0.001 + clearance, abs=1e-6)
    row, col = WORKSPACE.to_pixel(0.45, 0.0)
    seen.height[row - 4 : row + 4, col - 4 : col + 4] = 0.03
    z = linear(plan_primitive(push, seen, CONFIG), "push").X_base_tool.translation[2]
    assert z == pytest.approx(TABLE_Z + 0.03 + clearance, abs=1e-6)


def test_push_is_cut_at_the_border_and_says_so() -> None:
    push = Push(x=WORKSPACE.x_max - 0.062, y=0.0, z=TABLE_Z, yaw=0.0, length=0.1)
    plan = plan_primitive(push, table(), CONFIG)
    end = linear(plan, "push").X_base_tool.translation
    assert end[0] == pytest.approx(WORKSPACE.x_max)
    assert plan.notes == ("push shortened from 0.100 to 0.062 m: the workspace ends",)
    check(plan, CONFIG)


def test_push_without_room_is_refused() -> None:
    push = Push(x=WORKSPACE.x_max - 0.011, y=0.0, z=TABLE_Z, yaw=0.0)
    with pytest.raises(PlanRefused, match=r"has 0.011 m of room"):
        plan_primitive(push, table(), CONFIG)


@given(inside_x, inside_y, st.floats(-np.pi, np.pi))
def test_room_ahead_ends_on_the_border(x: float, y: float, yaw: float) -> None:
    room = room_ahead(Push(x=x, y=y, z=0.0, yaw=yaw), WORKSPACE)
    end = (x + room * np.cos(yaw), y + room * np.sin(yaw))
    assert WORKSPACE.contains(*end, margin=-1e-9)
    assert not WORKSPACE.contains(*end, margin=1e-6)


def test_push_into_the_unknown_may_not_start_there() -> None:
    seen = table()
    push = Push(x=0.45, y=0.0, z=TABLE_Z, yaw=0.0)
    (start,) = rectangles(CLOSED_GRIPPER[0], push)
    row, col = WORKSPACE.to_pixel(start.x, start.y)
    seen.height[row - 6 : row + 6, col - 6 : col + 6] = np.nan
    with pytest.raises(PlanRefused, match="unknown"):
        plan_primitive(push, seen, CONFIG)


# --- homing and reach -------------------------------------------------------------------------


def test_homing_goes_up_first_when_low() -> None:
    low = top_down(0.5, 0.0, TABLE_Z + 0.02, 0.4)
    raised, home = plan_homing(low, CONFIG)
    assert isinstance(raised, MoveLinear)
    np.testing.assert_allclose(raised.X_base_tool.translation, [0.5, 0.0, 0.1], atol=1e-9)
    assert raised.stop_force is not None
    assert isinstance(home, MoveJoints)
    np.testing.assert_allclose(home.q, CONFIG.arm.home)
    high = Transform(low.rotation, np.array([0.5, 0.0, 0.3]))
    assert len(plan_homing(high, CONFIG)) == 1


def test_out_of_reach_is_refused_with_the_place() -> None:
    far = CONFIG.model_copy(
        update={"limits": CONFIG.limits.model_copy(update={"travel_height": 0.9})}
    )
    with pytest.raises(PlanRefused, match=r'"above" \(0.700, 0.200, 0.750\) m is out of reach'):
        plan_primitive(Grasp(x=0.7, y=0.2, z=TABLE_Z, yaw=0.0), table(), far)
