from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from seen import CONFIG, TABLE_Z, row_of_bars, seen

from policies.primitives import Push
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import Pose
from tdpg_deploy.execution import execute, make_ready
from tdpg_deploy.foresight.imagined import grasps_after
from tdpg_deploy.motion import plan_primitive
from tools.train.pushes.free import GRASPS, free, look

AT_ITS_END = Push(x=0.58, y=0.0, z=TABLE_Z, yaw=np.pi)  # the goal slides out, towards the robot
PAST_IT_ALL = Push(x=0.40, y=0.15, z=TABLE_Z, yaw=0.0)
OUT_OF_THE_TABLE = Push(x=0.90, y=0.0, z=TABLE_Z, yaw=0.0)


@pytest.mark.parametrize("push", [AT_ITS_END, PAST_IT_ALL])
def test_what_is_foreseen_is_what_happens(push: Push) -> None:
    """In the mock cell, whose blocks are the real ones and whose camera is noisy."""
    table = row_of_bars()
    before = seen(table).heightmap
    with open_cell(CONFIG, scene=table) as cell:
        make_ready(cell)
        execute(plan_primitive(push, before, CONFIG), cell)
        freed = free(*look(cell), len(table.objects))[1]
    (grasps,) = grasps_after(before, [push], CONFIG)
    assert freed == (grasps >= GRASPS)
    assert freed == (push is AT_ITS_END)


def test_a_push_that_is_not_allowed_frees_nothing() -> None:
    assert list(grasps_after(seen(row_of_bars()).heightmap, [OUT_OF_THE_TABLE], CONFIG)) == [0]


def test_nothing_is_foreseen_of_a_goal_that_is_not_seen() -> None:
    heightmap = seen(row_of_bars()).heightmap
    assert heightmap.goal is not None
    hidden = dataclasses.replace(heightmap, goal=heightmap.goal & False)
    assert list(grasps_after(hidden, [AT_ITS_END], CONFIG)) == []


def test_the_truth_of_a_mock_cell_is_not_used() -> None:
    heightmap = seen(row_of_bars()).heightmap
    moved = Pose(position=(0.0, 0.0, 1.0), quaternion=(0.0, 1.0, 0.0, 0.0))
    truth = {"friction": 0.2, "density": 2000.0, "X_base_camera": moved, "carrier": "arm"}
    other = CONFIG.model_copy(update={"simulation": CONFIG.simulation.model_copy(update=truth)})
    foreseen = list(grasps_after(heightmap, [AT_ITS_END], CONFIG))
    assert foreseen == list(grasps_after(heightmap, [AT_ITS_END], other))
    assert foreseen[0] > 0
