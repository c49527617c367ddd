"""Tables that differ from each other as real ones do from simulated ones."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tdpg_deploy.cell_config import CellConfig, Pose
from tdpg_deploy.geometry import Transform
from tools.train.config import Randomization


def randomized(
    config: CellConfig, randomization: Randomization, rng: np.random.Generator
) -> CellConfig:
    """The same cell with another true camera pose, friction, density and light."""
    error = Transform(
        Rotation.from_rotvec(rng.normal(0, np.radians(randomization.camera_deg), 3)),
        rng.normal(0, randomization.camera_mm / 1000, 3),
    )
    X_base_camera = config.X_base_camera @ error
    truth = {
        "X_base_camera": Pose(
            position=tuple(X_base_camera.translation.tolist()),
            quaternion=tuple(X_base_camera.as_quaternion().tolist()),
        ),
    }
    simulation = config.simulation.model_copy(update=truth)
    return config.model_copy(update={"simulation": simulation})
