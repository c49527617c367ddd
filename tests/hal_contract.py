"""The promises of tdpg_deploy/hal.py as tests. Any implementation of a protocol subclasses

    class TestMyArm(ArmContract):
        @pytest.fixture
        def rig(self) -> ArmRig: ...

with devices freshly constructed and not yet connected, and inherits the tests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.errors import DeviceError, DeviceTimeout
from tdpg_deploy.geometry import Array, Transform, top_down
from tdpg_deploy.hal import (
    Arm,
    ArmState,
    Camera,
    Clock,
    Gripper,
    Holding,
    MotionEnd,
    MotionResult,
    OnArmState,
)
from tdpg_deploy.kinematics import branch_of, forward, inverse_batch, nearest

RATE = 20.0  # Hz, at which states have to come while moving
JITTER = 0.01  # s


@dataclass(frozen=True, kw_only=True)
class ArmRig:
    """floor_z: height in base (m) at which closed finger tips meet something solid at the
    centre of the workspace; the arm may move freely above. exact: position error (m) allowed."""

    arm: Arm
    clock: Clock
    config: CellConfig
    floor_z: float
    exact: float = 1e-3


@dataclass(frozen=True, kw_only=True)
class GripperRig:
    """hold: puts something between the open pads and returns its width (m); None where there is
    no way to. exact: width error (m) allowed."""

    gripper: Gripper
    clock: Clock
    hold: Callable[[], float] | None = None
    exact: float = 1.5e-3


@dataclass(frozen=True, kw_only=True)
class CameraRig:
    camera: Camera
    clock: Clock


class ArmContract:
    @pytest.fixture
    def arm(self, rig: ArmRig) -> Iterator[Arm]:
        rig.arm.connect()
        yield rig.arm
        rig.arm.stop()
        rig.arm.close()

    def test_close_and_stop_are_safe_at_any_time(self, rig: ArmRig) -> None:
        rig.arm.connect()
        rig.arm.stop()
        rig.arm.stop()
        rig.arm.close()
        rig.arm.close()

    def test_state_is_measured_now_and_agrees_with_itself(self, rig: ArmRig, arm: Arm) -> None:
        before = rig.clock.now()
        state = arm.state()
        assert before - JITTER <= state.stamp <= rig.clock.now() + JITTER
        assert state.q.shape == state.qd.shape == (6,)
        assert state.force.shape == (3,)
        distance, angle = state.X_base_tool.distance(
            forward(rig.config.arm.dh, state.q, _X_flange_tool(rig))
        )
        assert distance < rig.exact
        assert angle < 5e-3

    def test_connecting_moves_nothing(self, rig: ArmRig, arm: Arm) -> None:
        first = arm.state().q
        rig.clock.sleep(0.1)
        np.testing.assert_allclose(arm.state().q, first, atol=1e-3)

    def test_joints_arrive_and_stand_still(self, rig: ArmRig, arm: Arm) -> None:
        q = _joints_above(rig, 0.0, 0.0)
        result = _move_joints(rig, q)
        assert result.end is MotionEnd.REACHED
        np.testing.assert_allclose(result.state.q, q, atol=5e-3)
        np.testing.assert_allclose(arm.state().qd, 0.0, atol=0.02)
        assert arm.state().stamp >= result.state.stamp

    def test_line_is_straight_level_and_within_speed(self, rig: ArmRig, arm: Arm) -> None:
        _move_joints(rig, _joints_above(rig, -0.1, -0.1))
        states: list[ArmState] = []
        goal = _above(rig, 0.1, 0.1)
        result = _move_linear(rig, goal, speed=0.2, on_state=states.append)
        assert result.end is MotionEnd.REACHED
        assert result.state.X_base_tool.distance(goal)[0] < rig.exact
        start, end = _above(rig, -0.1, -0.1).translation, goal.translation
        along = (end - start) / np.linalg.norm(end - start)
        for state in states:
            way = state.X_base_tool.translation - start
            assert np.linalg.norm(way - along * (way @ along)) < 3e-3
        for last, state in pairwise(states):
            way = state.X_base_tool.translation - last.X_base_tool.translation
            assert np.linalg.norm(way) <= 0.2 * 1.1 * (state.stamp - last.stamp) + 1e-3

    def test_states_come_at_rate(self, rig: ArmRig, arm: Arm) -> None:
        _move_joints(rig, _joints_above(rig, -0.1, 0.0))
        moves: list[Callable[[OnArmState], MotionResult]] = [
            lambda on_state: _move_linear(rig, _above(rig, 0.1, 0.0), on_state=on_state),
            lambda on_state: _move_joints(rig, _joints_above(rig, -0.1, 0.0), on_state=on_state),
        ]
        for move in moves:
            states: list[ArmState] = []
            started = rig.clock.now()
            move(states.append)
            stamps = np.array([started, *(state.stamp for state in states), rig.clock.now()])
            assert np.diff(stamps[1:-1]).min() > 0
            # Coming to rest may take a moment after the last one.
            assert np.diff(stamps).max() < 1 / RATE + 0.1
            assert np.median(np.diff(stamps)) <= 1 / RATE + JITTER

    def test_guarded_descent_stops_at_the_floor(self, rig: ArmRig, arm: Arm) -> None:
        _move_joints(rig, _joints_above(rig, 0.0, 0.0))
        arm.zero_force()
        below = _at_floor(rig, -0.02)
        result = _move_linear(rig, below, speed=0.1, stop_force=15.0)
        assert result.end is MotionEnd.CONTACT
        assert abs(result.state.X_base_tool.translation[2] - rig.floor_z) < 0.006
        rest = arm.state()
        rig.clock.sleep(0.1)
        assert arm.state().X_base_tool.distance(rest.X_base_tool)[0] < 1e-3
        assert _move_linear(rig, _above(rig, 0.0, 0.0)).end is MotionEnd.REACHED

    def test_force_guard_lets_free_motion_pass(self, rig: ArmRig, arm: Arm) -> None:
        _move_joints(rig, _joints_above(rig, 0.0, 0.0))
        arm.zero_force()
        assert np.abs(arm.state().force).max() < 3.0
        for height in (0.05, 0.0):
            result = _move_linear(rig, _at_floor(rig, 0.05 + height), speed=0.15, stop_force=15.0)
            assert result.end is MotionEnd.REACHED

    def test_deadline_ends_a_motion(self, rig: ArmRig, arm: Arm) -> None:
        _move_joints(rig, _joints_above(rig, -0.1, 0.0))
        started = rig.clock.now()
        with pytest.raises(DeviceTimeout):
            _move_linear(rig, _above(rig, 0.1, 0.0), speed=0.05, deadline=0.5)
        assert rig.clock.now() - started < 0.5 + 1.0
        self._stands_still(rig)

    def test_stop_from_within_a_motion(self, rig: ArmRig, arm: Arm) -> None:
        _move_joints(rig, _joints_above(rig, -0.1, 0.0))

        def halt(state: ArmState) -> None:
            if state.X_base_tool.translation[0] > _above(rig, -0.05, 0.0).translation[0]:
                arm.stop()

        with pytest.raises(DeviceError):
            _move_linear(rig, _above(rig, 0.1, 0.0), speed=0.1, on_state=halt)
        assert arm.state().X_base_tool.translation[0] < _above(rig, 0.0, 0.0).translation[0]
        self._stands_still(rig)
        assert _move_linear(rig, _above(rig, 0.0, 0.0)).end is MotionEnd.REACHED

    def test_what_it_cannot_do_it_refuses_without_moving(self, rig: ArmRig, arm: Arm) -> None:
        _move_joints(rig, _joints_above(rig, 0.0, 0.0))
        before = arm.state().q
        with pytest.raises(DeviceError):
            _move_linear(rig, top_down(1.5, 0.0, 0.2, 0.0))
        with pytest.raises(DeviceError):
            _move_joints(rig, before + np.array([0, 0, 0, 0, 0, 20.0]))
        np.testing.assert_allclose(arm.state().q, before, atol=5e-3)

    def _stands_still(self, rig: ArmRig) -> None:
        before = rig.arm.state().q
        rig.clock.sleep(0.1)
        np.testing.assert_allclose(rig.arm.state().q, before, atol=2e-3)


class GripperContract:
    @pytest.fixture
    def gripper(self, rig: GripperRig) -> Iterator[Gripper]:
        rig.gripper.connect()
        rig.gripper.activate(deadline=10.0)
        yield rig.gripper
        rig.gripper.close()

    def test_close_twice(self, rig: GripperRig) -> None:
        rig.gripper.connect()
        rig.gripper.close()
        rig.gripper.close()

    def test_activate_twice(self, rig: GripperRig, gripper: Gripper) -> None:
        gripper.activate(deadline=10.0)
        assert gripper.state().width >= 0

    def test_width_is_reached_and_measured(self, rig: GripperRig, gripper: Gripper) -> None:
        for width in (gripper.max_width, 0.05, 0.02, 0.0, gripper.max_width):
            before = rig.clock.now()
            state = gripper.move(width, speed=0.1, force=20.0)
            assert state.width == pytest.approx(width, abs=rig.exact)
            assert not state.moving
            assert before <= state.stamp <= rig.clock.now() + JITTER
            assert gripper.state().width == pytest.approx(state.width, abs=1e-3)

    def test_closing_on_nothing_holds_nothing(self, rig: GripperRig, gripper: Gripper) -> None:
        gripper.move(gripper.max_width, speed=0.1, force=20.0)
        state = gripper.move(0.0, speed=0.1, force=20.0)
        assert state.holding is not Holding.OBJECT

    def test_closing_on_something_measures_its_width(
        self, rig: GripperRig, gripper: Gripper
    ) -> None:
        if rig.hold is None:
            pytest.skip("nothing to hold in this rig")
        gripper.move(gripper.max_width, speed=0.1, force=20.0)
        width = rig.hold()
        state = gripper.move(0.0, speed=0.1, force=20.0)
        assert state.width == pytest.approx(width, abs=2e-3)
        assert state.holding is Holding.OBJECT

    def test_speed_and_force_are_clamped(self, rig: GripperRig, gripper: Gripper) -> None:
        assert gripper.move(0.04, speed=9.0, force=9e3).width == pytest.approx(0.04, abs=rig.exact)
        assert gripper.move(0.06, speed=0.0, force=0.0).width == pytest.approx(0.06, abs=rig.exact)

    def test_deadline_ends_a_motion(self, rig: GripperRig, gripper: Gripper) -> None:
        gripper.move(gripper.max_width, speed=0.15, force=20.0)
        started = rig.clock.now()
        with pytest.raises(DeviceTimeout):
            gripper.move(0.0, speed=0.02, force=20.0, deadline=0.2)
        assert rig.clock.now() - started < 0.2 + 0.5


class CameraContract:
    @pytest.fixture
    def camera(self, rig: CameraRig) -> Iterator[Camera]:
        rig.camera.connect()
        yield rig.camera
        rig.camera.close()

    def test_close_twice(self, rig: CameraRig) -> None:
        rig.camera.connect()
        rig.camera.close()
        rig.camera.close()

    def test_frame_is_an_aligned_pair(self, rig: CameraRig, camera: Camera) -> None:
        frame, intrinsics = camera.capture(), camera.intrinsics
        assert frame.intrinsics == intrinsics
        assert frame.color.shape == (intrinsics.height, intrinsics.width, 3)
        assert frame.color.dtype == np.uint8
        assert frame.depth.shape == (intrinsics.height, intrinsics.width)
        assert frame.depth.dtype == np.float32
        assert frame.serial

    def test_unknown_depth_is_nan(self, rig: CameraRig, camera: Camera) -> None:
        depth = camera.capture().depth
        known = depth[np.isfinite(depth)]
        assert known.size > 0
        assert known.min() > 0.05
        assert known.max() < 20.0
        assert not np.isinf(depth).any()

    def test_frames_are_fresh(self, rig: CameraRig, camera: Camera) -> None:
        last = camera.capture()
        for _ in range(3):
            rig.clock.sleep(0.05)
            called = rig.clock.now()
            frame = camera.capture()
            assert frame.captured_at >= called
            assert frame.captured_at <= rig.clock.now() + JITTER
            assert frame.sequence > last.sequence
            assert not np.shares_memory(frame.color, last.color)
            assert not np.shares_memory(frame.depth, last.depth)
            last = frame


# --- where the arm goes -----------------------------------------------------------------------


def _above(rig: ArmRig, dx: float, dy: float) -> Transform:
    x, y = rig.config.workspace.center
    return top_down(x + dx, y + dy, rig.floor_z + rig.config.limits.travel_height, 0.0)


def _at_floor(rig: ArmRig, height: float) -> Transform:
    return top_down(*rig.config.workspace.center, rig.floor_z + height, 0.0)


def _joints_above(rig: ArmRig, dx: float, dy: float) -> Array:
    dh, home = rig.config.arm.dh, np.array(rig.config.arm.home)
    X_base_flange = _above(rig, dx, dy) @ _X_flange_tool(rig).inverse()
    branches = inverse_batch(dh, X_base_flange.as_matrix())[[branch_of(dh, home)]]
    q = nearest(branches, home, rig.config.limits.joint_range)
    assert q is not None
    return q


def _X_flange_tool(rig: ArmRig) -> Transform:
    return rig.config.arm.X_flange_tool.transform()


def _move_joints(rig: ArmRig, q: Array, *, on_state: OnArmState | None = None) -> MotionResult:
    return rig.arm.move_joints(q, speed=1.0, acceleration=1.4, deadline=20.0, on_state=on_state)


def _move_linear(
    rig: ArmRig,
    X_base_tool: Transform,
    *,
    speed: float = 0.25,
    deadline: float = 20.0,
    stop_force: float | None = None,
    on_state: OnArmState | None = None,
) -> MotionResult:
    return rig.arm.move_linear(
        X_base_tool,
        speed=speed,
        acceleration=1.2,
        deadline=deadline,
        stop_force=stop_force,
        on_state=on_state,
    )
