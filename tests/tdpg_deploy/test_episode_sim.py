"""The loop on the simulated cell: physics, camera noise and all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from policies.heightmap import SIZE, Heightmap
from policies.policy import ROTATIONS, Decision, QMaps
from policies.primitives import Grasp, Primitive
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.episode import run_episode
from tdpg_deploy.episode_record import EpisodeResult, NullRecorder
from tdpg_deploy.geometry import Transform
from tdpg_deploy.outcome import EndReason, GraspOutcome, Outcome, Verdict
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.scenes import Scene, SceneObject

EMPTY = np.full((ROTATIONS, SIZE, SIZE), -np.inf, np.float32)


class AlongY:
    """Grasps the middle of a highest thing, across the camera's view: no shadow falls there."""

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        highest = float(np.nanmax(heightmap.height))
        high = np.argwhere(heightmap.height > highest - 0.01)
        one = high[np.linalg.norm(high - high[0], axis=1) < 36]  # pixels: a cube's diagonal
        row, col = np.median(one, axis=0)
        x, y = heightmap.workspace.to_base(row, col)
        z = heightmap.workspace.table_z + highest
        return Decision(
            primitive=Grasp(x=float(x), y=float(y), z=z, yaw=np.pi / 2),
            rotation=4,
            row=int(row),
            col=int(col),
            q=0.0,
            maps=QMaps(push=EMPTY, grasp=EMPTY),
            verdict=None,
            seconds={},
        )


class Outcomes(NullRecorder):
    def __init__(self) -> None:
        self.all: list[Outcome] = []

    def conclude(self, outcome: Outcome, *, stamp: float) -> None:
        self.all.append(outcome)


def cubes(*places: tuple[float, float]) -> Scene:
    return Scene(
        objects=tuple(
            SceneObject(
                shape=SHAPES["cube"],
                X_base_object=Transform.from_quaternion((x, y, -0.12), (0, 0, 0, 1)),
                rgb=(200, 60, 60),
                goal=index == 0,
            )
            for index, (x, y) in enumerate(places)
        )
    )


def run(scene: Scene, *, goal: bool = False) -> tuple[EpisodeResult, list[Outcome]]:
    log = Outcomes()
    with open_cell(load_cell(DEFAULT_CELL), scene=scene, seed=3) as cell:
        rng = np.random.default_rng(3)
        return run_episode(cell, AlongY(), rng=rng, log=log, goal=goal), log.all


def test_cubes_end_in_the_bin_and_both_witnesses_saw_it() -> None:
    result, outcomes = run(cubes((0.45, 0.1), (0.58, -0.08)))
    assert result.reason is EndReason.CLEARED
    assert (result.actions, result.grasp_successes, result.delivered) == (2, 2, 2)
    assert result.truth == {"workspace": 0, "bin": 2, "outside": 0}
    for outcome in outcomes:
        assert isinstance(outcome, GraspOutcome)
        assert outcome.held_by_width is outcome.gone_from_map is Verdict.YES
        assert outcome.width_after_lift == pytest.approx(0.05, abs=0.002)


def test_the_same_seed_gives_the_same_episode() -> None:
    assert run(cubes((0.45, 0.1))) == run(cubes((0.45, 0.1)))


def test_the_goal_is_seen_and_fetched() -> None:
    result, _ = run(cubes((0.45, 0.1)), goal=True)
    assert result.reason is EndReason.GOAL_REACHED


def test_an_empty_table_is_cleared_without_an_action() -> None:
    result, _ = run(Scene(objects=()))
    assert (result.reason, result.actions) == (EndReason.CLEARED, 0)
