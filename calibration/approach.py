"""How the arm gets to a calibration pose: from home and back, through the gate of every motion."""

from __future__ import annotations

import numpy as np

from calibration import arm_shape
from tdpg_deploy import kinematics
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.errors import PlanRefused
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Arm
from tdpg_deploy.plan import MoveJoints
from tdpg_deploy.safety import check_steps

SPEED_SHARE = 0.5  # of the cell's joint speed and acceleration
DEADLINE = 60.0  # s


class Approach:
    """Joint motions that all pass through home. Moves nothing until `go`."""

    def __init__(self, config: CellConfig, arm: Arm) -> None:
        self._config = config
        self._arm = arm
        self._home = np.array(config.arm.home)

    def reach_by_hand(self, X_base_tool: Transform) -> Array | None:
        """Joints (6,) rad in which the arm can stand, or None."""
        arm = self._config.arm
        branches = kinematics.inverse(arm.dh, X_base_tool, arm.X_flange_tool.transform())
        return kinematics.nearest(branches, self._home, self._config.limits.joint_range)

    def reach(self, X_base_tool: Transform) -> Array | None:
        """Joints (6,) rad that `check` lets the arm go to from home and back, or None."""
        q = self.reach_by_hand(X_base_tool)
        if q is None:
            return None
        try:
            check_steps([self._step(q), self._step(self._home)], self._home, self._config)
        except PlanRefused:
            return None
        return q

    def hides(self, q: Array, eye: Array, points: Array) -> bool:
        """Whether the arm at q stands between the eye (3,) and points (n, 3) in base."""
        arm = self._config.arm
        return arm_shape.hides(arm.dh, q, arm.X_flange_tool.transform(), eye, points)

    def go(self, q: Array) -> None:
        """Home, then to q. Raises PlanRefused before anything moves."""
        steps = [self._step(self._home), self._step(q)]
        check_steps(steps, self._arm.state().q, self._config)
        for step in steps:
            self._arm.move_joints(
                step.q, speed=step.speed, acceleration=step.acceleration, deadline=DEADLINE
            )

    def go_home(self) -> None:
        self.go(self._home)

    def _step(self, q: Array) -> MoveJoints:
        limits = self._config.limits
        return MoveJoints(
            name="calibration pose",
            q=q,
            speed=SPEED_SHARE * limits.joint_speed,
            acceleration=SPEED_SHARE * limits.joint_acceleration,
        )
