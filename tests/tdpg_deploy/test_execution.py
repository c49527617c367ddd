from __future__ import annotations

import numpy as np
import pytest
from kinematic_cell import Box, FakeArm, FakeGripper, Table, kinematic_cell, kinematic_config

from policies.heightmap import SIZE, Heightmap, Workspace
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy.cell import Cell
from tdpg_deploy.errors import ArmError, DeviceError, GripperError, PlanRefused, ProtectiveStop
from tdpg_deploy.execution import execute, held, make_ready
from tdpg_deploy.geometry import Array
from tdpg_deploy.hal import ArmState, GripperState
from tdpg_deploy.motion import plan_primitive
from tdpg_deploy.outcome import GraspOutcome, PushOutcome, Verdict
from tdpg_deploy.plan import MoveJoints, MoveLinear, Plan
from tdpg_deploy.safety import check

CONFIG = kinematic_config()
TABLE_Z = CONFIG.workspace.table_z
WORKSPACE = Workspace(
    x_min=CONFIG.workspace.x_range[0], y_min=CONFIG.workspace.y_range[0], table_z=TABLE_Z
)
HOME = np.array(CONFIG.arm.home)
GRASP = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.05, yaw=0.0)
PUSH = Push(x=0.42, y=0.0, z=TABLE_Z, yaw=0.0)


def planned(primitive: Primitive) -> Plan:
    flat = Heightmap(
        workspace=WORKSPACE,
        color=np.zeros((SIZE, SIZE, 3), np.uint8),
        height=np.zeros((SIZE, SIZE), np.float32),
    )
    plan = plan_primitive(primitive, flat, CONFIG)
    check(plan, CONFIG)
    return plan


def ready(table: Table, **devices: object) -> Cell:
    cell = kinematic_cell(table, **devices)
    cell.gripper.activate()
    return cell


def grasped(table: Table) -> GraspOutcome:
    outcome = execute(planned(GRASP), ready(table))
    assert isinstance(outcome, GraspOutcome)
    return outcome


def pushed(table: Table) -> PushOutcome:
    outcome = execute(planned(PUSH), ready(table))
    assert isinstance(outcome, PushOutcome)
    return outcome


def test_grasp_measures_what_it_holds_and_lets_go_over_the_bin() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0, side=0.04))
    outcome = grasped(table)
    assert outcome.held_by_width is Verdict.YES
    assert outcome.width_after_close == outcome.width_after_lift == pytest.approx(0.04)
    assert outcome.width_at_release == pytest.approx(0.04)
    assert outcome.motion.contact is None
    assert outcome.gone_from_map is Verdict.UNKNOWN
    assert table.held is None
    assert table.boxes == []
    np.testing.assert_allclose(table.q, HOME)


def test_grasp_on_nothing_goes_home_without_the_bin() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0), slippery=True)
    arm = FakeArm(table)
    outcome = execute(planned(GRASP), ready(table, arm=arm))
    assert isinstance(outcome, GraspOutcome)
    assert outcome.held_by_width is Verdict.NO
    assert outcome.width_after_lift == 0.0
    assert np.isnan(outcome.width_at_release)
    assert arm.motions == ["joints", "zero", "linear", "linear", "linear", "joints"]
    np.testing.assert_allclose(table.q, HOME)


def test_contact_on_the_way_down_lifts_straight_and_goes_home() -> None:
    table = Table(CONFIG, Box(x=0.42, y=0.0, height=0.03))
    lifted: list[ArmState] = []
    outcome = execute(planned(PUSH), ready(table), on_state=lifted.append)
    assert isinstance(outcome, PushOutcome)
    assert outcome.motion.contact == "lower"  # the plan knows of no box
    assert outcome.travelled == pytest.approx(0.0, abs=1e-6)
    travel_z = TABLE_Z + CONFIG.limits.travel_height - 1e-6
    low = [s.X_base_tool.translation for s in lifted if s.X_base_tool.translation[2] < travel_z]
    np.testing.assert_allclose(np.array(low)[:, :2] - [0.42, 0.0], 0.0, atol=1e-6)
    np.testing.assert_allclose(table.q, HOME)


@pytest.mark.parametrize("primitive", [GRASP, PUSH])
def test_what_hangs_on_the_fingers_after_a_contact_is_told(primitive: Primitive) -> None:
    """A hooked mug: on the way down it meets the table, and closed pads have its handle between."""

    class Hooked(FakeGripper):
        def move(
            self, width: float, *, speed: float, force: float, deadline: float = 5.0
        ) -> GripperState:
            return super().move(max(width, 0.0128), speed=speed, force=force, deadline=deadline)

    class Low(FakeArm):
        def _touches(self, p_base: Array) -> bool:
            return float(p_base[2]) < TABLE_Z + 0.1

    table = Table(CONFIG)
    arm = Low(table)
    with pytest.raises(GripperError, match=r"hangs on the fingers.* 12\.8 mm .*\"lower\""):
        execute(planned(primitive), ready(table, arm=arm, gripper=Hooked(table)))
    assert arm.stops == 1
    np.testing.assert_allclose(table.q, HOME)


def test_push_measures_how_far_it_went() -> None:
    outcome = pushed(Table(CONFIG))
    assert outcome.travelled == pytest.approx(PUSH.length, abs=1e-6)
    assert outcome.motion.contact is None
    assert outcome.changed is Verdict.UNKNOWN


def test_states_are_passed_on() -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0, side=0.04))
    arm_states: list[ArmState] = []
    widths: list[GripperState] = []
    outcome = execute(
        planned(GRASP), ready(table), on_state=arm_states.append, on_gripper=widths.append
    )
    assert outcome.motion.seconds == pytest.approx(table.now())
    assert np.diff([state.stamp for state in arm_states]).max() < 2.0
    assert [state.width for state in widths] == pytest.approx([0.085, 0.04, 0.04, 0.04, 0.085])


@pytest.mark.parametrize("motion", range(5))
@pytest.mark.parametrize("failure", [ProtectiveStop("joint 3"), KeyboardInterrupt(), OSError(28)])
def test_whatever_fails_in_whichever_motion_the_arm_is_stopped(
    motion: int, failure: BaseException
) -> None:
    table = Table(CONFIG, Box(x=0.5, y=0.0, side=0.04))
    arm = FakeArm(table, fail_in=motion, failure=failure)
    with pytest.raises(type(failure)):
        execute(planned(GRASP), ready(table, arm=arm))
    assert arm.stops == 1


def test_a_failing_gripper_stops_the_arm() -> None:
    table = Table(CONFIG)
    arm, gripper = FakeArm(table), FakeGripper(table, failure=GripperError("fault 0x0A"))
    with pytest.raises(GripperError, match="0x0A"):
        execute(planned(GRASP), ready(table, arm=arm, gripper=gripper))
    assert arm.stops == 1


def test_a_listener_that_fails_stops_the_arm() -> None:
    def full(_: ArmState) -> None:
        raise OSError(28, "no space left on device")

    table = Table(CONFIG)
    arm = FakeArm(table)
    with pytest.raises(OSError, match="no space"):
        execute(planned(GRASP), ready(table, arm=arm), on_state=full)
    assert arm.stops == 1


def test_the_first_error_is_reported_when_stopping_fails_too() -> None:
    class Gone(FakeArm):
        def stop(self) -> None:
            raise DeviceError("no connection")

    table = Table(CONFIG)
    arm = Gone(table, fail_in=1, failure=ProtectiveStop("joint 3"))
    with pytest.raises(ProtectiveStop, match="joint 3"):
        execute(planned(GRASP), ready(table, arm=arm))


@pytest.mark.parametrize(
    ("width", "verdict"),
    [
        (0.0, Verdict.NO),
        (0.0025, Verdict.NO),
        (0.004, Verdict.UNKNOWN),
        (0.025, Verdict.YES),
        (0.081, Verdict.YES),
        (0.085, Verdict.UNKNOWN),
        (float("nan"), Verdict.UNKNOWN),
    ],
)
def test_held(width: float, verdict: Verdict) -> None:
    assert held(width, 0.085) is verdict


# --- making ready -----------------------------------------------------------------------------


def test_ready_at_home_moves_no_joint() -> None:
    table = Table(CONFIG)
    arm, gripper = FakeArm(table), FakeGripper(table)
    make_ready(kinematic_cell(table, arm=arm, gripper=gripper))
    assert arm.motions == []
    assert gripper.active


def test_ready_from_low_over_the_table_goes_up_first() -> None:
    table = Table(CONFIG)
    _, above, descend, *_ = planned(PUSH).approach
    assert isinstance(above, MoveJoints)
    assert isinstance(descend, MoveLinear)
    table.q = above.q
    arm = FakeArm(table)
    arm.move_linear(descend.X_base_tool, speed=0.1, acceleration=1.0, deadline=20.0)
    make_ready(kinematic_cell(table, arm=arm))
    assert arm.motions == ["linear", "linear", "joints"]
    np.testing.assert_allclose(table.q, HOME)


def test_ready_refuses_an_unsafe_way_home_before_moving() -> None:
    table = Table(CONFIG)
    table.q = np.deg2rad([90.0, 15.0, 0.0, -100.0, -90.0, 0.0])
    arm = FakeArm(table)
    with pytest.raises(PlanRefused):
        make_ready(kinematic_cell(table, arm=arm))
    assert arm.motions == []


def test_lifting_against_something_lets_go_and_tries_again_once() -> None:
    class Caught(FakeArm):
        """Cannot rise while the fingers are closed."""

        def _touches(self, p_base: Array) -> bool:
            return self.table.width < 0.08 and p_base[2] < TABLE_Z + 0.2

    table = Table(CONFIG, Box(x=0.5, y=0.0, side=0.04))
    outcome = execute(planned(GRASP), ready(table, arm=Caught(table)))
    assert isinstance(outcome, GraspOutcome)
    assert outcome.motion.contact == "lift"
    assert outcome.held_by_width is Verdict.NO
    np.testing.assert_allclose(table.q, HOME)

    class Stuck(FakeArm):
        def _touches(self, p_base: Array) -> bool:
            return len(self.motions) > 3

    with pytest.raises(ArmError, match=r"the arm is caught at .*free it by hand"):
        execute(planned(GRASP), ready(table, arm=Stuck(table)))
