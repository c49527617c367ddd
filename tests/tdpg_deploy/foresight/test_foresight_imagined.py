from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from seen import CONFIG, TABLE_Z, block, row_of_bars, seen

from policies.primitives import Grasp, Push
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import Pose
from tdpg_deploy.errors import PlanRefused
from tdpg_deploy.execution import execute, make_ready
from tdpg_deploy.foresight.imagined import WORLDS, ImaginedTable
from tdpg_deploy.motion import plan_primitive
from tdpg_deploy.outcome import GraspOutcome, Verdict
from tdpg_deploy.sim.scenes import Scene
from tools.train.pushes.free import GRASPS, free, look

AT_ITS_END = Push(x=0.58, y=0.0, z=TABLE_Z, yaw=np.pi)  # the goal slides out, towards the robot
PAST_IT_ALL = Push(x=0.40, y=0.15, z=TABLE_Z, yaw=0.0)
OUT_OF_THE_TABLE = Push(x=0.90, y=0.0, z=TABLE_Z, yaw=0.0)
ACROSS = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.05, yaw=np.pi / 2)
ALONG = Grasp(x=0.5, y=0.0, z=TABLE_Z + 0.05, yaw=0.0)  # longer than the fingers open


def imagined(scene: Scene) -> ImaginedTable:
    table = ImaginedTable.of(seen(scene).heightmap, CONFIG)
    assert table is not None
    return table


@pytest.mark.parametrize("push", [AT_ITS_END, PAST_IT_ALL])
def test_what_is_foreseen_of_a_push_is_what_happens(push: Push) -> None:
    """In the mock cell, whose blocks are the real ones and whose camera is noisy."""
    table = row_of_bars()
    before = seen(table).heightmap
    with open_cell(CONFIG, scene=table) as cell:
        make_ready(cell)
        execute(plan_primitive(push, before, CONFIG), cell)
        freed = free(*look(cell), len(table.objects))[1]
    counts = list(imagined(table).grasps_after(push))
    assert len(counts) == WORLDS
    assert {count >= GRASPS for count in counts} == {freed}
    assert freed == (push is AT_ITS_END)


def test_worlds_differ_and_are_the_same_again() -> None:
    table = imagined(row_of_bars())
    counts = list(table.grasps_after(AT_ITS_END))
    assert len(set(counts)) > 1
    assert counts == list(table.grasps_after(AT_ITS_END))


@pytest.mark.parametrize(("grasp", "alone"), [(ACROSS, True), (ACROSS, False), (ALONG, True)])
def test_what_is_foreseen_of_a_grasp_is_what_happens(grasp: Grasp, alone: bool) -> None:
    """A bar that stands alone can be taken across, one between two others cannot."""
    table = row_of_bars()
    if alone:
        table = Scene(objects=table.objects[1:2])
    with open_cell(CONFIG, scene=table) as cell:
        make_ready(cell)
        try:
            outcome = execute(plan_primitive(grasp, seen(table).heightmap, CONFIG), cell)
        except PlanRefused:
            taken = False
        else:
            assert isinstance(outcome, GraspOutcome)
            taken = outcome.held_by_width is Verdict.YES
    assert set(imagined(table).takes_goal(grasp)) == {taken}
    assert taken == (alone and grasp is ACROSS)


def test_to_hold_something_else_is_not_to_take_the_goal() -> None:
    beside = block("cube", 0.4, 0.15)
    table = Scene(objects=(*row_of_bars().objects[1:2], beside))
    assert not any(imagined(table).takes_goal(Grasp(x=0.4, y=0.15, z=TABLE_Z + 0.05, yaw=0.0)))


def test_a_push_that_is_not_allowed_frees_nothing() -> None:
    assert set(imagined(row_of_bars()).grasps_after(OUT_OF_THE_TABLE)) == {0}


def test_nothing_is_imagined_of_a_goal_that_is_not_seen() -> None:
    heightmap = seen(row_of_bars()).heightmap
    assert heightmap.goal is not None
    hidden = dataclasses.replace(heightmap, goal=heightmap.goal & False)
    assert ImaginedTable.of(hidden, CONFIG) is None


def test_the_truth_of_a_mock_cell_is_not_used() -> None:
    heightmap = seen(row_of_bars()).heightmap
    moved = Pose(position=(0.0, 0.0, 1.0), quaternion=(0.0, 1.0, 0.0, 0.0))
    truth = {"friction": 0.2, "density": 2000.0, "X_base_camera": moved, "carrier": "arm"}
    other = CONFIG.model_copy(update={"simulation": CONFIG.simulation.model_copy(update=truth)})
    here, there = (ImaginedTable.of(heightmap, config) for config in (CONFIG, other))
    assert here is not None
    assert there is not None
    foreseen = list(here.grasps_after(AT_ITS_END))
    assert foreseen == list(there.grasps_after(AT_ITS_END))
    assert foreseen[0] > 0
