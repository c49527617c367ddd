"""What becomes of the goal, push by push, in a simulated cell on which stands what was seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from policies.heightmap import Heightmap
from policies.masks import sure_grasps
from policies.primitives import Push
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import CellConfig, SimulationSection
from tdpg_deploy.errors import DeviceError, PlanRefused, SceneError
from tdpg_deploy.execution import execute, make_ready
from tdpg_deploy.foresight.solids import scene_shown
from tdpg_deploy.motion import plan_primitive
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.safety import check
from tdpg_deploy.sim.hurry import in_a_hurry
from tdpg_deploy.sim.scenes import Scene
from tdpg_deploy.workspace import workspace_of

NEAR = 0.20  # m between the middles of the goal and of a thing that may come into play


def grasps_after(heightmap: Heightmap, pushes: Sequence[Push], config: CellConfig) -> Iterator[int]:
    """For one push after the other, how many pixels and rotations would be sure grasps of the goal
    after it; 0 for a push that does not pass the check. Nothing where no goal is seen.

    Only what `heightmap` shows and the cell file says of the cell is used: what is true of a mock
    cell alone (camera pose, friction, density) is not. The same input gives the same numbers.
    """
    scene = _near_goal(scene_shown(heightmap))
    if not scene.objects:
        return
    imagined = _imagined(config)
    for push in pushes:
        try:
            check(plan_primitive(push, heightmap, config), config)
            grasps = _grasps_after(push, heightmap, imagined, scene)
        except (PlanRefused, SceneError, DeviceError):
            grasps = 0
        yield grasps


def _near_goal(scene: Scene) -> Scene:
    """Without what is so far from the goal that no push for it gets there: half of the work in a
    heap of thirty."""
    goals = [item.X_base_object.translation for item in scene.objects if item.goal]
    return Scene(
        objects=tuple(
            item
            for item in scene.objects
            if any(np.hypot(*(item.X_base_object.translation - goal)[:2]) < NEAR for goal in goals)
        )
    )


def _imagined(config: CellConfig) -> CellConfig:
    camera = config.camera.model_copy(update={"calibration": None})
    simulation = SimulationSection(depth_noise=False)
    return in_a_hurry(config.model_copy(update={"camera": camera, "simulation": simulation}))


def _grasps_after(push: Push, heightmap: Heightmap, imagined: CellConfig, scene: Scene) -> int:
    plan = plan_primitive(push, heightmap, imagined)
    with open_cell(imagined, scene=scene) as cell:
        make_ready(cell)
        execute(plan, cell)
        after = _look(cell)
    assert after.goal is not None
    return int(np.count_nonzero(sure_grasps(replace(after, goal=None), after.goal)))


def _look(cell: Cell) -> Heightmap:
    assert cell.goal_pixels is not None  # a simulated cell knows its goal
    config, frame = cell.config, cell.camera.capture()
    pose, workspace = config.X_base_camera, workspace_of(config)
    return build_heightmap(frame, pose, workspace, goal_pixels=cell.goal_pixels(frame))
