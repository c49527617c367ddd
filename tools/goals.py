"""Which objects of a simulated cell may be asked for: the same for training and evaluation."""

from __future__ import annotations

import numpy as np

from tdpg_deploy.cell import Cell
from tdpg_deploy.choosing import is_seen
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.sim.goal import GoalDetector
from tdpg_deploy.workspace import workspace_of


def detector_of(cell: Cell) -> GoalDetector:
    """What knows a simulated cell's objects."""
    detector = cell.goal_pixels
    assert isinstance(detector, GoalDetector), "a real cell's objects have no numbers"
    return detector


def in_sight(cell: Cell) -> list[int]:
    """Objects of which a look shows enough for an episode not to call the goal lost."""
    config, frame = cell.config, cell.camera.capture()
    owner = detector_of(cell).owner(frame)
    seen = []
    for index in np.unique(owner[owner >= 0]).tolist():
        heightmap = build_heightmap(
            frame, config.X_base_camera, workspace_of(config), goal_pixels=owner == index
        )
        assert heightmap.goal is not None
        if is_seen(heightmap.goal):
            seen.append(index)
    return seen
