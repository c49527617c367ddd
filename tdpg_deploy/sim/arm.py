"""hal.Arm over the simulated robot, whatever carries it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tdpg_deploy.errors import ArmError, DeviceTimeout
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import ArmState, MotionEnd, MotionResult, OnArmState
from tdpg_deploy.sim.physics import TIME_STEP
from tdpg_deploy.sim.profile import trapezoid
from tdpg_deploy.sim.world import World

TURN_RADIUS = 0.2  # m; a turn of one radian takes as long as a way of this length
REPORT_EVERY = 10  # steps: 24 Hz, a little more than hal.Arm promises
BLOCKED = 0.005  # m or rad between where a joint is and where it was driven
PRESSED_STEPS = 2  # in a row; a knock is one step long, and a force sensor's filter hides it
RELIEF_STEPS = 4
ARRIVAL_STEPS = 24  # for the motors to make up for what held them on the way


class SimArm:
    """Moves `world` step by step while it moves. Use from the thread that made the world;
    only `stop` may come from another."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._robot = world.robot
        self._X_flange_tool = world.config.arm.X_flange_tool.transform()
        self._q: Array = np.array(world.config.arm.home)  # which branch a gantry stands for
        self._zero: Array = np.zeros(3)
        self._stop = False

    def connect(self) -> None:
        """Nothing to open: the world is there."""

    def close(self) -> None:
        """Nothing to release: motions block, so the arm stands still."""

    def state(self) -> ArmState:
        joints, speeds = self._robot.joints()
        carrier = self._robot.carrier
        self._q = carrier.arm_joints(joints, self._q)
        ahead = carrier.arm_joints(joints + speeds * TIME_STEP, self._q)
        return ArmState(
            q=self._q,
            qd=(ahead - self._q) / TIME_STEP,
            X_base_tool=carrier.flange(joints) @ self._X_flange_tool,
            force=self._robot.force() - self._zero,
            stamp=self._world.clock.now(),
        )

    def zero_force(self) -> None:
        self._zero = self._robot.force()

    def move_joints(
        self,
        q: Array,
        *,
        speed: float,
        acceleration: float,
        deadline: float,
        on_state: OnArmState | None = None,
    ) -> MotionResult:
        q = np.asarray(q, np.float64)
        low, high = self._world.config.limits.joint_range
        if q.shape != (6,) or not ((q >= low) & (q <= high)).all():
            raise ArmError(f"joints {q} rad are not six angles in [{low:.2f}, {high:.2f}]")
        share = trapezoid(np.abs(q - self.state().q).max(), speed, acceleration, TIME_STEP)
        rows = self._robot.carrier.along_joints(self._robot.joints()[0], q, share)
        result = self._run(rows, deadline=deadline, stop_force=None, on_state=on_state)
        self._q = q  # a gantry takes the short way round, the arm that it stands for does not
        return replace(result, state=self.state())

    def move_linear(
        self,
        X_base_tool: Transform,
        *,
        speed: float,
        acceleration: float,
        deadline: float,
        stop_force: float | None = None,
        on_state: OnArmState | None = None,
    ) -> MotionResult:
        distance, angle = self.state().X_base_tool.distance(X_base_tool)
        share = trapezoid(max(distance, TURN_RADIUS * angle), speed, acceleration, TIME_STEP)
        rows = self._robot.carrier.along_line(
            self._robot.joints()[0], X_base_tool @ self._X_flange_tool.inverse(), share
        )
        return self._run(rows, deadline=deadline, stop_force=stop_force, on_state=on_state)

    def stop(self) -> None:
        """The motion that runs ends with ArmError within a step."""
        self._stop = True

    def _run(
        self,
        rows: Array,
        *,
        deadline: float,
        stop_force: float | None,
        on_state: OnArmState | None,
    ) -> MotionResult:
        if len(rows):  # where the arm itself could not stand, a gantry refuses as well
            self._robot.carrier.arm_joints(rows[-1], self._q)
        self._stop = False
        clock, robot = self._world.clock, self._robot
        ends = clock.now() + deadline
        pressed = 0
        for number, row in enumerate(rows.tolist()):
            robot.drive(row)
            self._world.step()
            if stop_force is not None:
                pressed = pressed + 1 if self._pressed(stop_force) else 0
            if pressed == PRESSED_STEPS:
                if on_state is not None:
                    on_state(self.state())  # the one that tells of the force
                self._back_off(rows[max(number - PRESSED_STEPS, 0)])
                return MotionResult(end=MotionEnd.CONTACT, state=self.state())
            if on_state is not None and number % REPORT_EVERY == 0:
                on_state(self.state())
            if self._stop:
                self._halt()
                raise ArmError("the motion was stopped: move again when it is safe")
            if clock.now() > ends:
                self._halt()
                raise DeviceTimeout(
                    f"the motion did not end within {deadline:g} s: allow more, or go faster"
                )
        if len(rows):
            self._arrive(rows[-1])
        return MotionResult(end=MotionEnd.REACHED, state=self.state())

    def _pressed(self, limit: float) -> bool:
        change = self._robot.force() - self._zero
        return bool(change @ change > limit * limit)

    def _halt(self) -> None:
        self._robot.hold()
        self._world.step()

    def _back_off(self, before: Array) -> None:
        """Stand where the force began, a millimetre or two back: pressing on would keep it up."""
        self._robot.drive(before.tolist())
        for _ in range(RELIEF_STEPS):
            self._world.step()

    def _arrive(self, goal: Array) -> None:
        for _ in range(ARRIVAL_STEPS):
            off = np.abs(self._robot.joints()[0] - goal).max()
            if off < BLOCKED:
                return
            self._world.step()
        self._halt()
        raise ArmError(
            f"something blocks the arm: a joint stands {off:.3f} (m or rad) from its goal. "
            "Clear the way, or guard the motion with stop_force"
        )
