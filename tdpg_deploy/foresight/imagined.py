"""What becomes of the goal, action by action, in simulated cells on which stands what was seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from policies.heightmap import Heightmap
from policies.masks import sure_grasps
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import CellConfig, SimulationSection
from tdpg_deploy.errors import DeviceError, PlanRefused, SceneError
from tdpg_deploy.execution import execute, make_ready
from tdpg_deploy.foresight.solids import scene_shown
from tdpg_deploy.geometry import Transform
from tdpg_deploy.motion import plan_primitive
from tdpg_deploy.outcome import GraspOutcome, Verdict
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.safety import check
from tdpg_deploy.sim.hurry import in_a_hurry
from tdpg_deploy.sim.scenes import Scene, SceneObject
from tdpg_deploy.workspace import workspace_of

NEAR = 0.15  # m between the middles of the goal and of a thing that may come into play
WORLDS = 8
SHIFT = 0.0004  # m, standard deviation: so well is it known where a thing stands
TURN = 0.4  # deg, likewise
FRICTION = 0.3  # share by which that of a world is less or more than likely, at most


class Imagined(Protocol):
    """What was seen, to try actions on: in one world after the other, the likeliest first, as long
    as whoever asks goes on."""

    def takes_goal(self, grasp: Grasp) -> Iterator[bool]:
        """Whether it would."""

    def grasps_after(self, push: Push) -> Iterator[int]:
        """How many pixels and rotations would be sure grasps of the goal after it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImaginedTable:
    """`Imagined` in simulation: the code of any cell in simulated ones.

    An action that does not pass the check, or that no world can hold, comes to nothing. Only what
    `heightmap` shows and the cell file says of the cell is used: what is true of a mock cell alone
    (camera pose, friction, density) is not. The same input gives the same answers.
    """

    heightmap: Heightmap
    config: CellConfig
    scene: Scene

    @classmethod
    def of(cls, heightmap: Heightmap, config: CellConfig) -> ImaginedTable | None:
        """None where no goal is seen."""
        scene = _near_goal(scene_shown(heightmap))
        if not scene.objects:
            return None
        return cls(heightmap=heightmap, config=config, scene=scene)

    def takes_goal(self, grasp: Grasp) -> Iterator[bool]:
        for tried in self._worlds_after(grasp):
            yield tried is not None and tried.held and not tried.goal_seen

    def grasps_after(self, push: Push) -> Iterator[int]:
        for tried in self._worlds_after(push):
            yield 0 if tried is None else tried.sure_grasps

    def _worlds_after(self, primitive: Primitive) -> Iterator[_Tried | None]:
        try:
            check(plan_primitive(primitive, self.heightmap, self.config), self.config)
        except PlanRefused:
            yield from repeat(None, WORLDS)
            return
        for number in range(WORLDS):
            yield self._tried(primitive, *_world(number, self.scene, self.config))

    def _tried(self, primitive: Primitive, scene: Scene, config: CellConfig) -> _Tried | None:
        try:
            plan = plan_primitive(primitive, self.heightmap, config)
            with open_cell(config, scene=scene) as cell:
                make_ready(cell)
                outcome = execute(plan, cell)
                after = _look(cell)
        except (PlanRefused, SceneError, DeviceError):
            return None
        held = isinstance(outcome, GraspOutcome) and outcome.held_by_width is Verdict.YES
        return _Tried(held=held, after=after)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Tried:
    """held: whether the gripper held something. after: what is seen then."""

    held: bool
    after: Heightmap

    @property
    def goal_seen(self) -> bool:
        return self.after.goal is not None and bool(self.after.goal.any())

    @property
    def sure_grasps(self) -> int:
        if self.after.goal is None:
            return 0
        seen = replace(self.after, goal=None)
        return int(np.count_nonzero(sure_grasps(seen, self.after.goal)))


def _near_goal(scene: Scene) -> Scene:
    """Without what is so far from the goal that no action on it gets there: half of the work in a
    heap of thirty."""
    goals = [item.X_base_object.translation for item in scene.objects if item.goal]
    return Scene(
        objects=tuple(
            item
            for item in scene.objects
            if any(np.hypot(*(item.X_base_object.translation - goal)[:2]) < NEAR for goal in goals)
        )
    )


def _world(number: int, scene: Scene, config: CellConfig) -> tuple[Scene, CellConfig]:
    """The likeliest, number 0, or one that might be as well: what lies close together is moved
    otherwise if it lies a tenth of a millimetre beside."""
    camera = config.camera.model_copy(update={"calibration": None})
    simulation = SimulationSection(depth_noise=False)
    if number:
        rng = np.random.default_rng(number)
        scene = Scene(objects=tuple(_beside(item, rng) for item in scene.objects))
        friction = simulation.friction * rng.uniform(1 - FRICTION, 1 + FRICTION)
        simulation = simulation.model_copy(update={"friction": friction})
    update = {"camera": camera, "simulation": simulation}
    return scene, in_a_hurry(config.model_copy(update=update))


def _beside(item: SceneObject, rng: np.random.Generator) -> SceneObject:
    pose = item.X_base_object
    turn = Rotation.from_euler("z", rng.normal(0, TURN), degrees=True)
    shift = np.array([*rng.normal(0, SHIFT, 2), 0.0])
    return replace(item, X_base_object=Transform(turn * pose.rotation, pose.translation + shift))


def _look(cell: Cell) -> Heightmap:
    assert cell.goal_pixels is not None  # a simulated cell knows its goal
    config, frame = cell.config, cell.camera.capture()
    pose, workspace = config.X_base_camera, workspace_of(config)
    return build_heightmap(frame, pose, workspace, goal_pixels=cell.goal_pixels(frame))
