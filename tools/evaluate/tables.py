"""The tables that policies meet: random ones, challenge cases, novel objects, the user's files.

The same table, cell and seed give the same objects in the same places, whatever the policy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.errors import SceneError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.novel import NOVEL
from tdpg_deploy.sim.scene_file import load_scene, parse_scene
from tdpg_deploy.sim.scenes import Scene, random_scene
from tdpg_deploy.workspace import workspace_of
from tools.goals import in_sight

CASES = Path(__file__).parent / "scenes"
CASES_MIDDLE = np.array([0.5, 0.0, -0.15])  # m, base: the mock cell's table, as their files have it
CASE_SHIFT = 0.02  # m, of a case as a whole, on each axis


class Table(Protocol):
    """name: unique, in file names too. groups: sets that it counts in, the largest first."""

    @property
    def name(self) -> str: ...

    @property
    def groups(self) -> tuple[str, ...]: ...

    def scene(self, cell: CellConfig, seed: int, *, goal: bool) -> Scene:
        """What lies on it. goal: one object has to be marked as the one to fetch.

        Raises SceneError.
        """


@dataclass(frozen=True, kw_only=True)
class RandomTable:
    """Objects of random shape, pose and colour, let fall in a heap: the blocks of the training,
    or novel ones. With a goal, the one to fetch is drawn from those that the first look shows."""

    objects: int
    novel: bool = False

    @property
    def name(self) -> str:
        return f"{'novel' if self.novel else 'random'}-{self.objects}"

    @property
    def groups(self) -> tuple[str, ...]:
        return (self.name.replace("-", " "),)

    def scene(self, cell: CellConfig, seed: int, *, goal: bool) -> Scene:
        rng = np.random.default_rng(seed)
        shapes = NOVEL if self.novel else SHAPES
        scene = random_scene(self.objects, workspace_of(cell), rng, shapes)
        return with_seen_goal(scene, cell, seed, rng) if goal else scene


@dataclass(frozen=True, kw_only=True)
class SceneTable:
    """A scene file as it stands."""

    file: Path

    @property
    def name(self) -> str:
        return self.file.stem

    @property
    def groups(self) -> tuple[str, ...]:
        return (self.name,)

    def scene(self, cell: CellConfig, seed: int, *, goal: bool) -> Scene:
        scene = load_scene(self.file, workspace_of(cell))
        if goal and not any(item.goal for item in scene.objects):
            raise SceneError(f"{self.file}: no object is marked goal = true: mark one")
        return scene


@dataclass(frozen=True, kw_only=True)
class CaseTable:
    """A challenge case, turned and shifted as a whole: blocks that touch go on touching, yet no
    two seeds show the same picture."""

    file: Path

    @property
    def name(self) -> str:
        return f"case-{self.file.stem}"

    @property
    def groups(self) -> tuple[str, ...]:
        level = int(self.file.stem[0])
        return ("cases", f"cases, level {'I' * level}", f"case {self.file.stem}")

    def scene(self, cell: CellConfig, seed: int, *, goal: bool) -> Scene:
        rng = np.random.default_rng(seed)
        turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
        shift = rng.uniform(-CASE_SHIFT, CASE_SHIFT, 2)
        middle = np.array([*(cell.workspace.center + shift), cell.workspace.table_z])
        X_base_case = Transform(turn, middle - turn.apply(CASES_MIDDLE))
        case = parse_scene(self.file.read_text(encoding="utf-8"))
        scene = Scene(
            objects=tuple(
                replace(item, X_base_object=X_base_case @ item.X_base_object)
                for item in case.objects
            )
        )
        scene.check(workspace_of(cell))
        return scene


def challenge_cases() -> list[CaseTable]:
    """All nine, the easiest level first."""
    return [CaseTable(file=file) for file in sorted(CASES.glob("*.toml"))]


def with_seen_goal(scene: Scene, cell: CellConfig, seed: int, rng: np.random.Generator) -> Scene:
    """With one of the objects that the first look shows as the goal. Raises SceneError."""
    with open_cell(cell, scene=scene, seed=seed) as opened:
        seen = in_sight(opened)
    if not seen:
        raise SceneError("the first look shows no object that could be the goal")
    return scene.with_goal(int(rng.choice(seen)))
