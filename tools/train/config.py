"""One experiment: everything that decides a training run, in one file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tdpg_deploy.errors import ConfigError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Rollout(_Section):
    """How experience is gathered, in rounds: every worker plays with the same frozen weights."""

    workers: int = Field(2, ge=1, le=64)
    actions: int = Field(24, ge=1, description="of each worker in a round")
    min_objects: int = Field(10, ge=1, le=30)
    max_objects: int = Field(10, ge=1, le=30)
    epsilon_start: float = Field(0.5, ge=0, le=1)  # paper, section III-D
    epsilon_end: float = Field(0.1, ge=0, le=1)


class Randomization(_Section):
    """What differs from scene to scene, so that the real table is one more of them.

    Factors are drawn from 1 +- the value; camera_mm and camera_deg are the standard deviation
    of the calibration's error.
    """

    friction: float = Field(0.3, ge=0, lt=1)
    density: float = Field(0.3, ge=0, lt=1)
    camera_mm: float = Field(1.0, ge=0)
    camera_deg: float = Field(0.1, ge=0)
    lighting: bool = True


class Learning(_Section):
    """Paper, section III-D. The weight decay printed there, 2^-5 = 0.03, would pull every weight
    to zero within a few hundred steps of Adam; the code that the paper derives from has 2e-5."""

    learning_rate: float = Field(1e-4, gt=0)
    last_learning_rate: float = Field(1e-4, gt=0, description="reached along a half cosine")
    betas: tuple[float, float] = (0.9, 0.99)
    weight_decay: float = Field(2e-5, ge=0)
    discount: float = Field(0.5, ge=0, lt=1)
    batch: int = Field(64, ge=1)
    updates_per_action: float = Field(1.0, gt=0)
    warmup: int = Field(64, ge=1, description="transitions before the first update")
    priority_exponent: float = Field(0.6, ge=0, le=1)  # Schaul et al. 2016, alpha
    importance_exponent: float = Field(0.4, ge=0, le=1)  # beta at the start; ends at 1


class TrainConfig(_Section):
    """actions: how many the whole run executes. width: of the light network, at stride 2."""

    stage: Literal["grasp"] = "grasp"
    seed: int = 0
    actions: int = Field(1000, ge=1)
    width: int = Field(16, ge=4, le=64)
    rollout: Rollout = Rollout()
    randomization: Randomization = Randomization()
    learning: Learning = Learning()


def load_train_config(path: Path) -> TrainConfig:
    """Read an experiment's TOML file. Raises ConfigError that names field and value."""
    try:
        return TrainConfig.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, tomllib.TOMLDecodeError, ValidationError) as error:
        raise ConfigError(f"{path}: {error}") from error


def overridden(
    config: TrainConfig, *, actions: int | None, seed: int | None, workers: int | None
) -> TrainConfig:
    """The same experiment but for what is not None. Raises ConfigError."""
    data = config.model_dump()
    data |= {
        name: value for name, value in (("actions", actions), ("seed", seed)) if value is not None
    }
    if workers is not None:
        data["rollout"]["workers"] = workers
    try:
        return TrainConfig.model_validate(data)
    except ValidationError as error:
        raise ConfigError(str(error)) from error
