"""Try a logged action in the simulated cell. An estimate, and marked as one.

Where the log has the scene that a simulated episode began with, the actions before are run again:
the same physics and seed lead to the same table, bit for bit. Where it has none, as on a real
cell, boxes are fitted to the heightmap.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import islice

import numpy as np

from policies.heightmap import Heightmap
from policies.primitives import Primitive
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.episode import witnessed
from tdpg_deploy.episode_log import documents
from tdpg_deploy.episode_log.entries import Intent, Look, Step
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.errors import DeviceError, LogError, PlanRefused, SceneError
from tdpg_deploy.execution import execute, make_ready
from tdpg_deploy.outcome import Outcome
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.plan import MoveLinear, Plan
from tdpg_deploy.safety import check
from tdpg_deploy.sim.scene_file import parse_scene
from tdpg_deploy.sim.scenes import Scene
from tdpg_deploy.workspace import workspace_of
from tools.replay.box_fit import fit_boxes

ALIKE = 0.01  # m; as much as `change` takes for no change


class TableFrom(Enum):
    SCENE = "the logged scene, after the logged actions before"
    HEIGHTMAP = "boxes fitted to the logged heightmap"


@dataclass(frozen=True, kw_only=True)
class Tried:
    """How the logged action of step `number` goes in the simulated cell: an estimate.

    likeness: share of the heights known in both, before the action, that are ALIKE; nan without
    a look. logged, outcome: of the cell that was logged, and of the simulated one; None where it
    is not known. error: why the plan was refused, or what the simulated cell's devices raised.
    """

    number: int
    table: TableFrom
    objects: int
    likeness: float
    primitive: Primitive
    logged: Outcome | None
    outcome: Outcome | None
    error: str | None

    @property
    def same(self) -> bool:
        """Whether both outcomes are known and the same, bit for bit; nan is like nan."""
        if self.logged is None or self.outcome is None:
            return False
        return documents.encode(self.logged) == documents.encode(self.outcome)


def reenact(episode: Episode, number: int) -> Tried:
    """Raises LogError where step `number` has no action or no look to start from, and SceneError
    where the table cannot be rebuilt; PlanRefused where an action before cannot be run again."""
    if episode.about.scene is not None:
        return _on_the_scene(episode, parse_scene(episode.about.scene), number)
    return _on_boxes(episode, number)


def _on_the_scene(episode: Episode, scene: Scene, number: int) -> Tried:
    about = episode.about
    with open_cell(about.cell, scene=scene, seed=about.seed or 0) as cell:
        make_ready(cell)
        before = _look(cell)
        for at, step in enumerate(episode.steps(states=False), start=1):
            intent = _intent(step, at)
            if at == number:
                return _try(cell, step, intent, before, at, TableFrom.SCENE, len(scene.objects))
            _run(intent.plan, cell)
            before = _look(cell)
    raise _no_such_step(number)


def _on_boxes(episode: Episode, number: int) -> Tried:
    step = next(islice(episode.steps(states=False), number - 1, None), None)
    if step is None:
        raise _no_such_step(number)
    intent, look = _intent(step, number), step.look
    if look is None:
        raise LogError(f"the look of step {number} is lost: nothing to fit boxes to")
    scene = fit_boxes(look.heightmap)
    if not scene.objects:
        raise SceneError(f"nothing rises above the table in the look of step {number}")
    with open_cell(episode.about.cell, scene=scene, seed=episode.about.seed or 0) as cell:
        make_ready(cell)
        table = TableFrom.HEIGHTMAP
        return _try(cell, step, intent, _look(cell), number, table, len(scene.objects))


def _try(
    cell: Cell,
    step: Step,
    intent: Intent,
    before: Heightmap,
    number: int,
    table: TableFrom,
    objects: int,
) -> Tried:
    plan: Plan = intent.plan
    outcome, error = None, None
    try:
        outcome = witnessed(_run(plan, cell), plan.primitive, before, _look(cell))
    except (DeviceError, PlanRefused) as failure:
        error = f"{type(failure).__name__}: {failure}"
    return Tried(
        number=number,
        table=table,
        objects=objects,
        likeness=likeness(step.look, before),
        primitive=plan.primitive,
        logged=step.outcome,
        outcome=outcome,
        error=error,
    )


def _run(plan: Plan, cell: Cell) -> Outcome:
    """A log may hold any plan: it is checked like one that was just made. Raises PlanRefused."""
    if not plan.approach or not isinstance(plan.approach[-1], MoveLinear):
        raise PlanRefused("the logged plan does not end its approach with a lift")
    check(plan, cell.config)
    return execute(plan, cell)


def _look(cell: Cell) -> Heightmap:
    config = cell.config
    return build_heightmap(cell.camera.capture(), config.X_base_camera, workspace_of(config))


def likeness(look: Look | None, seen: Heightmap) -> float:
    """Share of the heights known in both that differ by less than ALIKE."""
    if look is None:
        return float("nan")
    both = look.heightmap.valid & seen.valid
    return float((np.abs(look.heightmap.height - seen.height)[both] < ALIKE).mean())


def _intent(step: Step, number: int) -> Intent:
    if step.intent is None:
        raise LogError(f"step {number} has no action: all that was decided was refused")
    return step.intent


def _no_such_step(number: int) -> LogError:
    return LogError(f"the log has no step {number}")
