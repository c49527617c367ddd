"""Random tables are of the blocks that were asked for."""

from __future__ import annotations

import numpy as np

from policies.heightmap import Workspace
from tdpg_deploy.errors import SceneError
from tdpg_deploy.sim.bodies import SHAPES
from tools.train.laid import random_table

WORKSPACE = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)


def test_tables_are_of_the_blocks_that_were_asked_for() -> None:
    """And of stones, a few."""
    blocks = {name: SHAPES[name] for name in ("bar", "cube")}
    tables = []
    for seed in range(40):
        try:
            table = random_table(WORKSPACE, 1.0, np.random.default_rng(seed), blocks)
        except SceneError:
            continue  # a heap that is too much for the workspace
        tables.append({item.shape.name for item in table.objects})
    of_blocks = [names for names in tables if names <= {*SHAPES}]
    assert 25 <= len(of_blocks) < len(tables)
    assert set().union(*of_blocks) == {"bar", "cube"}
