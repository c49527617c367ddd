"""Random tables, and tables laid again as they were left: the same may be tried twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from policies.heightmap import Workspace
from tdpg_deploy.cell import Cell
from tdpg_deploy.sim.bodies import SHAPES, Shape
from tdpg_deploy.sim.clusters import clustered_scene
from tdpg_deploy.sim.random_shapes import odd_shapes
from tdpg_deploy.sim.scenes import MAX_PACKED, Scene, packed_scene, random_scene
from tdpg_deploy.sim.world import ObjectState, World
from tools.goals import detector_of

ODD, HEAPS, PACKS = 0.12, 0.12, 0.23  # shares of tables of stones, in heaps, in rows; else clusters
HEAP = (3, 25)  # objects


def random_table(
    workspace: Workspace,
    compact: float,
    rng: np.random.Generator,
    blocks: Mapping[str, Shape] = SHAPES,
) -> Scene:
    """Mostly clusters, where pushes matter. compact: share of them that grow compact. blocks: what
    there is, besides stones. Raises SceneError."""
    shapes = odd_shapes(rng) if rng.random() < ODD else blocks
    kind = rng.random()
    if kind < HEAPS:
        return random_scene(int(rng.integers(HEAP[0], HEAP[1] + 1)), workspace, rng, shapes)
    if kind < HEAPS + PACKS:
        return packed_scene(int(rng.integers(2, MAX_PACKED + 1)), workspace, rng, shapes)
    tight = compact > 0 and rng.random() < compact
    return clustered_scene(workspace, rng, shapes, compact=tight)


def as_left(scene: Scene, states: Sequence[ObjectState], kept: Sequence[bool]) -> Scene:
    """What is kept of a scene, where it lies now."""
    return Scene(
        objects=tuple(
            replace(item, X_base_object=state.X_base_object)
            for item, state, keep in zip(scene.objects, states, kept, strict=True)
            if keep
        )
    )


def world_of(cell: Cell) -> World:
    """The physics of a simulated cell."""
    return detector_of(cell).world
