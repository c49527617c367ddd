from __future__ import annotations

import numpy as np
import pytest
import torch

from policies.heightmap import SIZE, Heightmap, Workspace
from policies.networks.light import LightNet
from policies.rotation import patches
from policies.state import encode
from tools.train.grasps.course import judged
from tools.train.grasps.lessons import lessons_of
from tools.train.grasps.play import GraspRecord
from tools.train.replay import pack_height, unpack_height


def record(seed: int, looks: int = 2) -> GraspRecord:
    """Looks at noise; from each three grasps, one beside the border, the first of which held."""
    rng = np.random.default_rng(seed)
    height = rng.uniform(0, 0.1, (looks, SIZE, SIZE)).astype(np.float32)
    height[:, 90:95, 100:120] = np.nan
    places = [(1, 100, 110), (6, 40, 200), (3, 2, 5)]
    return GraspRecord(
        heights=pack_height(height),
        colors=rng.integers(0, 256, (looks, SIZE, SIZE, 3), np.uint8),
        grasps=np.array([(look, *at) for look in range(looks) for at in places], np.int16),
        held=np.array([True, False, False] * looks),
    )


def test_a_grasp_is_shown_as_the_network_sees_it() -> None:
    records = [record(0), record(1, looks=1)]
    lessons = lessons_of(records)
    cuts, places = lessons.questions(np.arange(len(lessons)))
    states, grasps = [], []
    for each in records:
        for look, *grasp in each.grasps.tolist():
            heightmap = Heightmap(
                workspace=Workspace(x_min=0.0, y_min=0.0, table_z=0.0),
                color=each.colors[look],
                height=unpack_height(each.heights[look]),
            )
            states.append(encode(heightmap, goal=False))
            grasps.append(grasp)
    expected = patches(states, *torch.tensor(grasps).T, size=LightNet.PATCH, stride=LightNet.STRIDE)
    torch.testing.assert_close(cuts, expected[0])
    torch.testing.assert_close(places, expected[1])
    assert lessons.answer.tolist() == [1, 0, 0] * 3
    assert lessons.look.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_another_cell_might_show_it_mirrored_turned_and_in_other_colours() -> None:
    lessons = lessons_of([record(0)])
    rng = np.random.default_rng(0)
    plain, _ = lessons.questions(np.zeros(16, np.intp))
    shown, places = lessons.questions(np.zeros(16, np.intp), rng)
    for each in shown:
        turns = [each, each.flip(2), each.flip(1), each.flip(1, 2)]
        assert any(torch.equal(turn[:3], plain[0, :3]) for turn in turns)
    assert len(torch.unique(shown, dim=0)) > 8
    assert len(torch.unique(places, dim=0)) == 4


def test_of_the_grasps_of_one_look_the_likeliest_is_compared_with_all() -> None:
    lessons = lessons_of([record(0)])
    right, wrong = np.array([2, -2, -2], np.float32), np.array([-2, 2, -2], np.float32)
    validation = judged(lessons, np.concatenate((right, wrong)))
    assert validation.held is not None
    assert validation.held.chosen == 0.5
    assert validation.held.any == pytest.approx(1 / 3)
    assert validation.held.best == 1
    probabilities = [1 / (1 + np.exp(-2.0)), 1 / (1 + np.exp(2.0))]  # of what came, right and wrong
    expected = -(4 * np.log(probabilities[0]) + 2 * np.log(probabilities[1])) / 6
    assert validation.loss == pytest.approx(expected)
