"""hal.Gripper over the simulated 2F-85: real fingers, real friction, a motor with a force limit."""

from __future__ import annotations

from collections import deque

import numpy as np

from tdpg_deploy.errors import DeviceTimeout, GripperError
from tdpg_deploy.hal import GripperState, Holding
from tdpg_deploy.sim.links import MAX_WIDTH
from tdpg_deploy.sim.physics import TIME_STEP
from tdpg_deploy.sim.world import World

SPEEDS = (0.020, 0.150)  # m/s, 2F-85 instruction manual
FORCES = (10.0, 20.0)  # N on each pad. The real one reaches 235; 80 in the simulator shed objects
AT_GOAL = 0.001  # m
TREMBLE = 0.010  # m/s, of fingers that hold something
BLOCKED_STEPS = 12  # 50 ms in which the fingers make no headway
HEADWAY = 0.0004  # m; at the lowest speed it would be 0.001


class SimGripper:
    """Moves `world` step by step while it moves. Use from the thread that made the world."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._robot = world.robot
        self._active = False
        self._goal = world.robot.width()
        self._closing = False

    @property
    def max_width(self) -> float:
        return MAX_WIDTH

    def connect(self) -> None:
        """Nothing to open: the world is there."""

    def close(self) -> None:
        """Keeps the fingers, and what is between them, as they are."""

    def activate(self, *, deadline: float = 10.0) -> None:
        self._active = True

    def state(self) -> GripperState:
        width, speed = self._robot.width(), self._robot.width_speed()
        moving = abs(speed) > TREMBLE
        if moving:
            holding = Holding.UNKNOWN
        elif self._closing and width > self._goal + AT_GOAL:
            holding = Holding.OBJECT
        else:
            holding = Holding.NOTHING
        return GripperState(
            width=width, moving=moving, holding=holding, stamp=self._world.clock.now()
        )

    def move(
        self, width: float, *, speed: float, force: float, deadline: float = 5.0
    ) -> GripperState:
        if not self._active:
            raise GripperError("the gripper is not activated: call activate first")
        speed, force = float(np.clip(speed, *SPEEDS)), float(np.clip(force, *FORCES))
        clock, robot = self._world.clock, self._robot
        ends = clock.now() + deadline
        reached = robot.width()
        lately = deque([np.nan] * BLOCKED_STEPS, maxlen=BLOCKED_STEPS)  # widths
        self._goal = float(np.clip(width, 0.0, MAX_WIDTH))
        self._closing = self._goal < reached
        target = reached
        while not self._ended(lately):
            travel = np.clip(self._goal - target, -speed * TIME_STEP, speed * TIME_STEP)
            target += float(travel)
            robot.drive_fingers(target, force)
            self._world.step()
            lately.append(robot.width())
            if clock.now() > ends:
                robot.hold_fingers(self._goal, force)
                raise DeviceTimeout(f"the fingers still move after {deadline:g} s: allow more")
        robot.hold_fingers(self._goal, force)  # and hold on
        return self.state()

    def _ended(self, lately: deque[float]) -> bool:
        """Whether the fingers stand at the goal, or made no headway in the last widths."""
        there = abs(lately[-1] - self._goal) < AT_GOAL
        still = abs(lately[-1] - lately[-2]) < TREMBLE * TIME_STEP
        return (there and still) or abs(lately[-1] - lately[0]) < HEADWAY
