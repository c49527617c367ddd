"""The arm of the simulated world as what a controller moves."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tdpg_deploy.geometry import Array
from tdpg_deploy.kinematics import forward_batch
from tdpg_deploy.sim.physics import TIME_STEP
from tdpg_deploy.sim.world import World

# The world's motors are rigid: what they press on takes 400 N within a tenth of a millimetre.
# Real joints and rubber tips give way, so that a controller has time to see a force and to stop.
RIGID = 80.0  # N; more is an obstacle, less is something that is pushed
STIFFNESS = 20_000.0  # N/m of the arm and its tips, against obstacles
GONE_AFTER = 12  # steps without contact until an obstacle is believed to be gone
SPEED_OVER = 4  # steps: at rest Bullet's motors tremble from one to the next, for ever


@dataclass(frozen=True, kw_only=True)
class _Obstacle:
    """Where the arm was when it met it, and the direction (3,) in which it was pressed."""

    q: Array
    p_base_tip: Array
    direction: Array


class WorldPlant:
    """`plant.Plant` over a world whose arm is no gantry. Steps the world, which nobody else may.

    before_step: called before each step of the world; for what else moves in it.
    """

    def __init__(self, world: World, *, before_step: Callable[[], None] = lambda: None) -> None:
        self._world, self._robot, self._before_step = world, world.robot, before_step
        self.dh = world.config.arm.dh
        self._tip = np.append(world.config.arm.X_flange_tool.transform().translation, 1.0)
        self._q_target = self.q
        self._lately = deque([self.q] * (SPEED_OVER + 1), maxlen=SPEED_OVER + 1)  # joints
        self._ahead = 0.0  # s of the controller that the world has not been stepped for yet
        self._obstacle: _Obstacle | None = None
        self._untouched = 0  # steps in a row without a contact

    @property
    def q(self) -> Array:
        return self._robot.joints()[0]

    @property
    def qd(self) -> Array:
        return (self._lately[-1] - self._lately[0]) / (SPEED_OVER * TIME_STEP)

    @property
    def force(self) -> Array:
        if self._obstacle is None:
            return self._robot.force()
        return STIFFNESS * self._depth(self._obstacle, self._q_target) * self._obstacle.direction

    def drive(self, q_target: Array, dt: float) -> None:
        before, self._q_target = self._q_target, q_target
        since = -self._ahead  # of the next world step, after `before` was the target
        self._ahead += dt
        while self._ahead >= TIME_STEP:
            self._ahead -= TIME_STEP
            since += TIME_STEP
            self._step(before + (q_target - before) * (since / dt))

    def _step(self, q_target: Array) -> None:
        if self._obstacle is not None and (
            self._depth(self._obstacle, q_target) <= 0  # the target has come back
            or self._untouched >= GONE_AFTER  # fingers have let go, or what stood there has slid
        ):
            self._obstacle = None
        held = self._obstacle is not None
        self._robot.drive((self._obstacle.q if self._obstacle else q_target).tolist())
        self._before_step()
        self._world.step()
        self._lately.append(self.q)
        force = self._robot.force()
        pressed = float(np.linalg.norm(force))
        self._untouched = 0 if pressed > 0 else self._untouched + 1
        if not held and pressed > RIGID:
            q = self.q
            self._obstacle = _Obstacle(q=q, p_base_tip=self._place(q), direction=force / pressed)

    def _depth(self, obstacle: _Obstacle, q_target: Array) -> float:
        """Metres by which the target lies beyond the obstacle's surface."""
        return float((obstacle.p_base_tip - self._place(q_target)) @ obstacle.direction)

    def _place(self, q: Array) -> Array:
        place: Array = (forward_batch(self.dh, q) @ self._tip)[:3]
        return place
