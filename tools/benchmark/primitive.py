"""Grasps in the simulated cell: wall time by carrier, and how far the carriers agree."""

from __future__ import annotations

import time

import numpy as np

from policies.baselines import RandomPolicy
from policies.heightmap import Heightmap
from policies.primitives import Primitive
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.errors import PlanRefused
from tdpg_deploy.execution import execute, make_ready
from tdpg_deploy.motion import plan_primitive
from tdpg_deploy.outcome import GraspOutcome, Verdict
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.plan import Plan
from tdpg_deploy.safety import check
from tdpg_deploy.sim.scenes import Scene, random_scene
from tdpg_deploy.workspace import workspace_of
from tools.benchmark.measure import Measurement
from tools.train.trainer import training_cell

OBJECTS = (10, 20, 30)
GRASPS = 40  # for each timing
PAIRS = 60  # same table, same grasp, both carriers


def run() -> list[Measurement]:
    """Random grasps, contact or not, as a beginner tries them; from home to home."""
    training, mock = training_cell(), load_cell(DEFAULT_CELL)
    timings = [
        _wall_time(name, config, objects)
        for objects in OBJECTS
        for name, config in (("training", training), ("mock", mock))
    ]
    agreed = [_agree(training, mock, seed) for seed in range(PAIRS)]
    share = float(np.mean(agreed))
    agreement = Measurement(
        name="both carriers hold, or neither does",
        unit="of grasps",
        median=share,
        low=share,
        high=share,
        repeats=PAIRS,
    )
    return [*timings, agreement]


def _wall_time(name: str, config: CellConfig, objects: int) -> Measurement:
    seconds: list[float] = []
    seed = 0
    while len(seconds) < GRASPS:  # a new table when half of it is cleared
        rng = np.random.default_rng(seed)
        with _table(config, objects, rng, seed) as cell:
            make_ready(cell)
            for _ in range(objects // 2):
                plan, _ = _random_plan(cell, rng)
                start = time.perf_counter()
                execute(plan, cell)
                seconds.append(time.perf_counter() - start)
        seed += 1
    low, median, high = (float(value) for value in np.percentile(seconds, (5, 50, 95)))
    return Measurement(
        name=f"grasp, {name} carrier, {objects} objects",
        unit="s",
        median=median,
        low=low,
        high=high,
        repeats=len(seconds),
    )


def _agree(training: CellConfig, mock: CellConfig, seed: int) -> bool:
    """Whether the same random grasp on the same table ends alike on both carriers."""
    rng = np.random.default_rng(seed)
    with _table(training, 10, rng, seed) as cell:
        make_ready(cell)
        plan, heightmap = _random_plan(cell, rng)
        first = _held(plan, cell)
    with _table(mock, 10, np.random.default_rng(seed), seed) as cell:
        make_ready(cell)
        return _held(plan_primitive(plan.primitive, heightmap, mock), cell) == first


def _held(plan: Plan, cell: Cell) -> bool:
    outcome = execute(plan, cell)
    assert isinstance(outcome, GraspOutcome)
    return outcome.held_by_width is Verdict.YES


def _table(config: CellConfig, objects: int, rng: np.random.Generator, seed: int) -> Cell:
    scene: Scene = random_scene(objects, workspace_of(config), rng)
    return open_cell(config, scene=scene, seed=seed)


def _random_plan(cell: Cell, rng: np.random.Generator) -> tuple[Plan, Heightmap]:
    heightmap = build_heightmap(
        cell.camera.capture(), cell.config.X_base_camera, workspace_of(cell.config)
    )
    refused: list[Primitive] = []
    while True:
        decision = RandomPolicy().decide(heightmap, rng, avoid=refused)
        try:
            plan = plan_primitive(decision.primitive, heightmap, cell.config)
            check(plan, cell.config)
        except PlanRefused:
            refused.append(decision.primitive)
        else:
            return plan, heightmap
