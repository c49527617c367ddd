"""The arm of the simulated world as what a controller moves."""

from __future__ import annotations

from tdpg_deploy.geometry import Array
from tdpg_deploy.sim.physics import TIME_STEP
from tdpg_deploy.sim.world import World


class WorldPlant:
    """`plant.Plant` over a world that a UR5 carries. Steps the world, which nobody else may."""

    def __init__(self, world: World) -> None:
        self._world, self._robot = world, world.robot
        self._q_target = self.q
        self._ahead = 0.0  # s of the controller that the world has not been stepped for yet

    @property
    def q(self) -> Array:
        return self._robot.joints()[0]

    @property
    def qd(self) -> Array:
        return self._robot.joints()[1]

    @property
    def force(self) -> Array:
        return self._robot.force()

    def drive(self, q_target: Array, dt: float) -> None:
        before, self._q_target = self._q_target, q_target
        since = -self._ahead  # of the next world step, after `before` was the target
        self._ahead += dt
        while self._ahead >= TIME_STEP:
            self._ahead -= TIME_STEP
            since += TIME_STEP
            self._robot.drive((before + (q_target - before) * (since / dt)).tolist())
            self._world.step()
