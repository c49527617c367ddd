"""One experiment: everything that decides a training run, in one file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from policies.networks.build import WIDTHS
from tdpg_deploy.errors import ConfigError
from tdpg_deploy.sim.bodies import SHAPES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

StageKind: TypeAlias = Literal["grasp", "push", "synergy"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Stage(_Section):
    """Paper, section III-C. grasp (I): grasps only. push (II): a push and its validation grasp
    in turn. synergy (III): whatever the policy chooses. Every push and every grasp counts as
    one of the stage's actions."""

    kind: StageKind
    actions: int = Field(ge=1)
    min_objects: int = Field(10, ge=1, le=30)
    max_objects: int = Field(10, ge=1, le=30)
    packed: float = Field(0.0, ge=0, le=1, description="share of tables that are one tight pack")
    odd: float = Field(0.0, ge=0, le=1, description="share of tables of stones and stumps")
    table_actions: int | None = Field(
        None, ge=2, description="after which a table is taken away; none: it is played to its end"
    )

    @model_validator(mode="after")
    def _least_is_not_above_most(self) -> Stage:
        if self.min_objects > self.max_objects:
            raise ValueError(
                f"min_objects = {self.min_objects} exceeds max_objects = {self.max_objects}"
            )
        return self


class Rollout(_Section):
    """How experience is gathered, in rounds: every worker plays with the same frozen weights.

    Epsilon falls evenly over the whole run.
    """

    workers: int = Field(2, ge=1, le=64)
    actions: int = Field(24, ge=1, description="of each worker in a round")
    epsilon_start: float = Field(0.5, ge=0, le=1)  # paper, section III-D
    epsilon_end: float = Field(0.1, ge=0, le=1)


class PushReward(_Section):
    """What a push is worth: the sum of what holds. A grasp is worth 1 if it succeeds.

    rose: the best grasp's value rose, by more than `least_rise` (paper, eq. 3, which asks for no
    more than a rise: between two looks at the same table noise makes every other one). validated:
    the grasp that followed succeeded (eq. 4). changed: something moved (VPG; nothing in this
    paper). idle: share of all this for a push that moved nothing; the paper does not ask. With a
    goal, a grasp that clears the way to it is worth what a push is.
    """

    rose: float = Field(0.5, ge=0)
    least_rise: float = Field(0.0, ge=0)
    validated: float = Field(0.5, ge=0)
    changed: float = Field(0.0, ge=0)
    idle: float = Field(1.0, ge=0, le=1)


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
    next_grasps: int = Field(
        10, ge=1, le=10, description="best of the next look whose values are refreshed"
    )
    next_action: Literal["grasp", "either"] = Field(
        "grasp", description="whose value is looked ahead to: eq. 1 of the paper, or VPG's"
    )
    batch: int = Field(64, ge=1)
    updates_per_action: float = Field(1.0, gt=0)
    warmup: int = Field(64, ge=1, description="transitions before the first update")
    priority_exponent: float = Field(0.6, ge=0, le=1)  # Schaul et al. 2016, alpha; 0: uniform
    importance_exponent: float = Field(0.4, ge=0, le=1)  # beta at the start; ends at 1


class Evaluation(_Section):
    """Greedy episodes on tables that are for validation only, after every `every` actions.

    seed: of the first table; tdpg-eval's begin at 10,000.
    """

    every: int = Field(1000, ge=1)
    episodes: int = Field(4, ge=0, description="0: none")
    objects: int = Field(20, ge=1, le=30)
    seed: int = Field(5000, ge=0)


class TrainConfig(_Section):
    """width: of the light network, at stride 2; of densenet121, its growth rate. goal: fetch
    objects instead of clearing the table. method: by which the synergy stage decides; where
    Critic II has no say in it, it is not trained. imagenet: torchvision's densenet121 state
    dict, which both towers begin with. start: a policy file whose weights the run begins with."""

    seed: int = 0
    network: Literal["light", "densenet121"] = "light"
    width: int = 16
    goal: bool = False
    method: Literal["vpg", "vpg+critic", "epg", "tdpg-base", "tdpg", "tdpg-sure"] = "tdpg"
    imagenet: Path | None = None
    start: Path | None = None
    stages: tuple[Stage, ...] = Field(min_length=1)
    rollout: Rollout = Rollout()
    push_reward: PushReward = PushReward()
    randomization: Randomization = Randomization()
    learning: Learning = Learning()
    evaluation: Evaluation = Evaluation()

    @model_validator(mode="after")
    def _network_exists(self) -> TrainConfig:
        widths = WIDTHS[self.network]
        if self.width not in widths:
            raise ValueError(
                f"width = {self.width} is not within {widths[0]} to {widths[-1]} for {self.network}"
            )
        if self.imagenet is not None and self.network != "densenet121":
            raise ValueError(f"imagenet weights are densenet121's, the network is {self.network}")
        return self

    @property
    def actions(self) -> int:
        """Of the whole run."""
        return sum(stage.actions for stage in self.stages)


class PushRound(_Section):
    """So many pushes are played, then PushNet learns from these and those before, from round
    `since` on (counted from 0), in so many updates. In the first round any allowed push is made, in
    others what PushNet values most by then."""

    pushes: int = Field(ge=1)
    compact: float = Field(0.0, ge=0, le=1, description="share of clusters that grow compact")
    knots: bool = Field(False, description="only for goals that are hemmed in")
    hard: bool = Field(False, description="of knots, mostly where PushNet's choice frees nothing")
    shapes: tuple[str, ...] = Field(tuple(SHAPES), min_length=1, description="of the blocks")
    since: int = Field(0, ge=0, description="the first round that is learnt from")
    explored: float = Field(
        0.0, ge=0, le=1, description="share of the pushes that are any, after the first round too"
    )
    updates: int = Field(ge=0)
    learning_rate: float = Field(1e-3, gt=0)

    @model_validator(mode="after")
    def _blocks_have_these_shapes(self) -> PushRound:
        unknown = sorted({*self.shapes} - {*SHAPES})
        if unknown:
            raise ValueError(f"no block is a {unknown[0]}: name some of {', '.join(SHAPES)}")
        return self

    @model_validator(mode="after")
    def _hard_ones_are_knots(self) -> PushRound:
        if self.hard and not self.knots:
            raise ValueError("hard = true asks for looks at one goal: set knots = true too")
        return self


class PushCourse(_Section):
    """A PushNet of its own for a policy that grasps, `start`."""

    course: Literal["pushes"]
    seed: int = 0
    start: Path | None = None
    workers: int = Field(2, ge=1, le=64)
    rounds: tuple[PushRound, ...] = Field(min_length=1)
    randomization: Randomization = Randomization()
    batch: int = Field(64, ge=1)
    weight_decay: float = Field(1e-3, ge=0)

    @model_validator(mode="after")
    def _teaches(self) -> PushCourse:
        if self.updates == 0:
            raise ValueError("no round has updates: nothing would be learnt")
        for number, each in enumerate(self.rounds):
            if each.since > number:
                raise ValueError(f"round {number} learns from round {each.since} on: a later one")
        return self

    @property
    def pushes(self) -> int:
        """Of the whole course."""
        return sum(each.pushes for each in self.rounds)

    @property
    def updates(self) -> int:
        return sum(each.updates for each in self.rounds)


class GraspRound(_Section):
    """So many grasps are tried, at looks of which the policy as it is by then is not sure; then it
    learns from these and all before in so many updates."""

    grasps: int = Field(ge=1)
    updates: int = Field(ge=1)
    learning_rate: float = Field(5e-4, gt=0)


class GraspCourse(_Section):
    """GraspNet and Critic II of a policy that clears tables, `start`. compact: share of the
    clusters that grow compact."""

    course: Literal["grasps"]
    seed: int = 0
    start: Path | None = None
    workers: int = Field(2, ge=1, le=64)
    rounds: tuple[GraspRound, ...] = Field(min_length=1)
    compact: float = Field(0.0, ge=0, le=1)
    randomization: Randomization = Randomization()
    batch: int = Field(64, ge=1)
    weight_decay: float = Field(1e-3, ge=0)

    @property
    def grasps(self) -> int:
        """Of the whole course."""
        return sum(each.grasps for each in self.rounds)

    @property
    def updates(self) -> int:
        return sum(each.updates for each in self.rounds)


class CoordinatorCourse(_Section):
    """GI's coordinator for the critics of a policy that reads a goal, `start`: from so many grasps
    of goals, some sensible and some not."""

    course: Literal["coordinator"]
    seed: int = 0
    start: Path | None = None
    workers: int = Field(2, ge=1, le=64)
    grasps: int = Field(ge=1)
    updates: int = Field(ge=1)
    randomization: Randomization = Randomization()
    batch: int = Field(64, ge=1)
    learning_rate: float = Field(1e-3, gt=0)


Experiment: TypeAlias = TrainConfig | PushCourse | CoordinatorCourse | GraspCourse


def load_experiment(path: Path) -> Experiment:
    """Read an experiment's TOML file, of any kind. Raises ConfigError that names field and
    value."""
    courses: dict[object, type[Experiment]] = {
        "pushes": PushCourse,
        "coordinator": CoordinatorCourse,
        "grasps": GraspCourse,
    }
    try:
        fields = tomllib.loads(path.read_text(encoding="utf-8"))
        return courses.get(fields.get("course"), TrainConfig).model_validate(fields)
    except (OSError, tomllib.TOMLDecodeError, ValidationError) as error:
        raise ConfigError(f"{path}: {error}") from error


Course = TypeVar("Course", bound=PushCourse | GraspCourse | CoordinatorCourse)


def overridden_course(
    course: Course,
    *,
    tries: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    start: Path | None = None,
) -> Course:
    """The same course but for what is not None; tries are the pushes or grasps of each round.
    Raises ConfigError."""
    data = course.model_dump()
    if tries is not None:
        for each in data.get("rounds", [data]):
            each["pushes" if isinstance(course, PushCourse) else "grasps"] = tries
    given = {
        "seed": seed,
        "workers": workers,
        "start": None if start is None else start.absolute(),
    }
    return _validated(type(course), data | _not_none(given))


def overridden(
    config: TrainConfig,
    *,
    actions: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    start: Path | None = None,
    imagenet: Path | None = None,
) -> TrainConfig:
    """The same experiment but for what is not None; actions are those of each stage.
    Raises ConfigError."""
    data = config.model_dump()
    if actions is not None:
        for stage in data["stages"]:
            stage["actions"] = actions
    if workers is not None:
        data["rollout"]["workers"] = workers
    given = {
        "seed": seed,
        "start": None if start is None else start.absolute(),
        "imagenet": None if imagenet is None else imagenet.absolute(),
    }
    return _validated(TrainConfig, data | _not_none(given))


def _not_none(given: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in given.items() if value is not None}


_Experiment = TypeVar("_Experiment", bound=_Section)


def _validated(kind: type[_Experiment], fields: dict[str, Any]) -> _Experiment:
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise ConfigError(str(error)) from error


def stage_after(config: TrainConfig, actions: int) -> tuple[Stage, int]:
    """The stage that follows when so many actions were made, and how many are left of it."""
    for stage in config.stages:
        if actions < stage.actions:
            return stage, stage.actions - actions
        actions -= stage.actions
    raise ValueError(f"the experiment ends after {config.actions} actions")
