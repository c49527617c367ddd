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
    simulation = config.simulation
    truth = {
        "friction": simulation.friction * rng.uniform(*_around(randomization.friction)),
        "density": simulation.density * rng.uniform(*_around(randomization.density)),
        "light": _lamp(rng) if randomization.lighting else simulation.light,
        "X_base_camera": Pose(
            position=tuple(X_base_camera.translation.tolist()),
            quaternion=tuple(X_base_camera.as_quaternion().tolist()),
        ),
    }
    return config.model_copy(update={"simulation": simulation.model_copy(update=truth)})


def _around(share: float) -> tuple[float, float]:
    return 1 - share, 1 + share


def _lamp(rng: np.random.Generator) -> tuple[float, float, float]:
    """Somewhere above, up to 60 degrees off the vertical."""
    azimuth, slant = rng.uniform(0, 2 * np.pi), rng.uniform(0, np.pi / 3)
    return (
        float(np.cos(azimuth) * np.sin(slant)),
        float(np.sin(azimuth) * np.sin(slant)),
        float(np.cos(slant)),
    )
