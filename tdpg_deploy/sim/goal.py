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


def goal_pixels(world: World, frame: RgbdFrame, goals: Collection[int]) -> npt.NDArray[np.bool_]:
    """(H, W): pixels of `frame` that show one of the scene's objects `goals`. The world must not
    have moved since the frame was taken."""
    owner = render(world.visible(), frame.intrinsics, true_pose(world.config)).owner
    return np.isin(owner, list(goals))
