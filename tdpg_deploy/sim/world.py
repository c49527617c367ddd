"""The simulated cell's physics: table, bin, objects and robot in one pybullet client.

The base frame is the world's frame. Time passes in steps of 1/240 s and only when somebody
waits or moves. The same config, scene and seed give the same outcomes, bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import pybullet

from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.errors import SceneError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.sim import furniture, physics
from tdpg_deploy.sim.bodies import Shape
from tdpg_deploy.sim.carriers import Carrier, Gantry, SerialArm
from tdpg_deploy.sim.links import MAX_WIDTH
from tdpg_deploy.sim.pieces import VisiblePiece
from tdpg_deploy.sim.robot import Robot
from tdpg_deploy.sim.scenes import Scene, SceneObject, Spawner
from tdpg_deploy.sim.tags import lay_tags
from tdpg_deploy.workspace import workspace_of

LOOK_EVERY = 16  # steps between looks at what may be put to sleep
CALM_LOOKS = 2  # in a row; one alone might meet an object where it turns round
REST_SPEED = 0.004  # m/s
REST_TURN = 0.08  # rad/s
DROP_HEIGHT = 0.06  # m above the highest object's centre, for what is dropped again
SETTLE_TIME = 4.0  # s for a drop to come to rest; what still trembles then is put to sleep
SETTLE_DROPS = 20  # rounds of dropping again what landed outside of the workspace


class Where(Enum):
    """By the centre of mass; an object in the gripper counts where it hangs."""

    WORKSPACE = "workspace"
    BIN = "bin"
    OUTSIDE = "outside"  # beside the workspace: on the table's rim or on the floor


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectState:
    """index: in the scene that the world was made from, for ever."""

    index: int
    shape: Shape
    X_base_object: Transform
    where: Where


class SimClock:
    """hal.Clock of a world: starts at 0 and grows as the physics is stepped."""

    def __init__(self, world: World) -> None:
        self._world = world

    def now(self) -> float:
        return self._world.steps * physics.TIME_STEP

    def sleep(self, seconds: float) -> None:
        for _ in range(int(np.ceil(seconds / physics.TIME_STEP))):
            self._world.step()


class World:
    """robot: the body that SimArm and SimGripper move. Single-threaded, as pybullet is."""

    def __init__(self, config: CellConfig, scene: Scene, *, seed: int) -> None:
        """Builds the cell with the arm at home, lets the objects fall, and drops again those
        that land outside of the workspace. Raises SceneError when they do not fit."""
        self.config = config
        self.workspace = workspace_of(config)
        scene.check(self.workspace)
        self.steps = 0
        self.clock = SimClock(self)
        self._scene = scene
        self.client = physics.connect()
        self._furniture = furniture.furnish(config, self.workspace)
        for item in self._furniture:
            physics.add_static(self.client, item.piece, friction=physics.TABLE_FRICTION)
        self._tags = lay_tags(self.workspace) if config.simulation.table_tags else []
        dh, rails = config.arm.dh, config.simulation.carrier == "gantry"
        carrier: Carrier = Gantry(dh) if rails else SerialArm(dh)
        self.robot = Robot(self.client, carrier, np.array(config.arm.home), MAX_WIDTH)
        self.bodies = [
            physics.add_object(
                self.client,
                item.shape,
                item.X_base_object,
                friction=config.simulation.friction,
                density=config.simulation.density,
            )
            for item in scene.objects
        ]
        self._calm = [0] * len(self.bodies)  # looks in a row at which it hardly moved
        try:
            self._settle(np.random.default_rng(seed))
        except SceneError:
            self.close()
            raise

    def close(self) -> None:
        """Free the physics. May be called twice."""
        if self.client >= 0:
            pybullet.disconnect(self.client)
            self.client = -1

    def step(self) -> None:
        """Let 1/240 s pass."""
        pybullet.stepSimulation(self.client)
        self.steps += 1
        if self.steps % LOOK_EVERY == 0:
            self._put_to_sleep()

    def objects(self) -> tuple[ObjectState, ...]:
        """All objects of the scene, wherever they are now; none is ever lost."""
        states = []
        for index, (item, body) in enumerate(zip(self._scene.objects, self.bodies, strict=True)):
            X_base_object = self._pose(body)
            states.append(
                ObjectState(
                    index=index,
                    shape=item.shape,
                    X_base_object=X_base_object,
                    where=self._where(X_base_object.translation),
                )
            )
        return tuple(states)

    def scene(self) -> Scene:
        """What lies in the workspace now, for recording or for building the same again."""
        return Scene(
            objects=tuple(
                SceneObject(
                    shape=state.shape,
                    X_base_object=state.X_base_object,
                    rgb=self._scene.objects[state.index].rgb,
                    goal=self._scene.objects[state.index].goal,
                )
                for state in self.objects()
                if state.where is Where.WORKSPACE
            )
        )

    def visible(self) -> list[VisiblePiece]:
        """Everything that a camera could see, where it is now."""
        objects = [
            VisiblePiece(
                piece, state.X_base_object, self._scene.objects[state.index].rgb, state.index
            )
            for state in self.objects()
            for piece in state.shape.pieces
        ]
        return [*self._furniture, *self._tags, *self.robot.visible(), *objects]

    # --- rest ---------------------------------------------------------------------------------

    def _settle(self, rng: np.random.Generator) -> None:
        self._come_to_rest()
        for _ in range(SETTLE_DROPS):
            astray = self._astray()
            if not astray:
                return
            heap = max(state.X_base_object.translation[2] for state in self.objects())
            spawner = Spawner(self.workspace, rng, above=heap + DROP_HEIGHT)
            for state in astray:
                self._drop(state.index, spawner.pose(state.shape))
            self._come_to_rest()
        if self._astray():
            raise SceneError(
                f"{len(self._astray())} of {len(self.bodies)} objects still fall out of the "
                f"workspace after {SETTLE_DROPS} drops: use fewer or lower objects"
            )

    def _astray(self) -> list[ObjectState]:
        return [state for state in self.objects() if state.where is not Where.WORKSPACE]

    def _drop(self, index: int, X_base_object: Transform) -> None:
        body, self._calm[index] = self.bodies[index], 0
        pybullet.resetBasePositionAndOrientation(
            body,
            X_base_object.translation.tolist(),
            X_base_object.rotation.as_quat().tolist(),
            physicsClientId=self.client,
        )
        pybullet.changeDynamics(
            body,
            -1,
            activationState=pybullet.ACTIVATION_STATE_WAKE_UP,
            physicsClientId=self.client,
        )

    def _come_to_rest(self) -> None:
        for _ in range(int(SETTLE_TIME / physics.TIME_STEP)):
            self.step()
            if all(calm >= CALM_LOOKS for calm in self._calm):
                break
        for body in self.bodies:
            self._sleep(body)

    def _put_to_sleep(self) -> None:
        """Bullet waits two seconds and keeps trembling heaps awake; every step of them costs."""
        for index, body in enumerate(self.bodies):
            linear, angular = pybullet.getBaseVelocity(body, self.client)
            calm = max(map(abs, linear)) < REST_SPEED and max(map(abs, angular)) < REST_TURN
            self._calm[index] = self._calm[index] + 1 if calm else 0
            if self._calm[index] >= CALM_LOOKS and any(linear):  # a sleeper's speed is 0
                self._sleep(body)

    def _sleep(self, body: int) -> None:
        pybullet.changeDynamics(
            body,
            -1,
            activationState=pybullet.ACTIVATION_STATE_SLEEP,
            physicsClientId=self.client,
        )

    # --- places -------------------------------------------------------------------------------

    def _pose(self, body: int) -> Transform:
        position, quaternion = pybullet.getBasePositionAndOrientation(body, self.client)
        return Transform.from_quaternion(position, quaternion)

    def _where(self, p_base: Array) -> Where:
        x, y, z = p_base
        if self.workspace.contains(x, y) and z > self.workspace.table_z:
            return Where.WORKSPACE
        if furniture.in_bin(self.config, p_base):
            return Where.BIN
        return Where.OUTSIDE
