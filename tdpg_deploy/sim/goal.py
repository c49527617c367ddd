"""Where the goal object is in a simulated camera's picture: what a detector would say of a real
one's."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from tdpg_deploy.hal import RgbdFrame
from tdpg_deploy.sim.camera import true_pose
from tdpg_deploy.sim.render import render
from tdpg_deploy.sim.world import World


class GoalDetector:
    """goals: the scene's objects to fetch; may be changed between episodes.

    world: what it looks at, which must not have moved since a frame was taken.
    """

    def __init__(self, world: World, goals: Collection[int]) -> None:
        self.goals = goals
        self.world = world

    def __call__(self, frame: RgbdFrame) -> npt.NDArray[np.bool_]:
        """(H, W): pixels of `frame` that show one of the goals."""
        return np.isin(self.owner(frame), list(self.goals))

    def owner(self, frame: RgbdFrame) -> npt.NDArray[np.int16]:
        """(H, W): the object that each pixel of `frame` shows, -1 where there is none."""
        world = self.world
        return render(world.visible(), frame.intrinsics, true_pose(world.config)).owner
