from __future__ import annotations

import numpy as np
import pytest
import torch

from policies import state
from policies.heightmap import SIZE, Heightmap, Workspace
from policies.networks.twin import AHEAD, PushNet
from policies.rotation import FRAME, pictures, to_picture
from policies.standing import RISE
from tools.train.pushes.lessons import ALL, lessons_of
from tools.train.pushes.play import PushRecord
from tools.train.replay import pack_height, unpack_height

HEIGHT = 0.05


def record(
    *, stuck: bool = False, pushes: list[tuple[int, int, int, int]] | None = None
) -> PushRecord:
    """One look at two blocks: 0, far up, and 1, right of the middle. Every push frees the second
    and takes the first off the table."""
    pushes = pushes or [(0, 0, 150, 130)]
    height = np.zeros((SIZE, SIZE), np.float32)
    owners = np.full((SIZE, SIZE), -1, np.int8)
    for index, (rows, cols) in enumerate(
        [(slice(10, 30), slice(20, 40)), (slice(100, 125), slice(120, 140))]
    ):
        height[rows, cols], owners[rows, cols] = HEIGHT, index
    height[200, 200] = np.nan
    color = np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3), np.uint8)

    def flags(*values: bool) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        return np.array([np.pad(values, (0, 28))] * len(pushes))

    return PushRecord(
        heights=pack_height(height)[None],
        colors=color[None],
        owners=owners[None],
        objects=np.array([2], np.int8),
        free=flags(False, False)[:1],
        stuck=np.array([stuck]),
        pushes=np.array(pushes, np.int16),
        free_after=flags(True, True),
        on_table_after=flags(False, True),
        taken_after=flags(False, True),
    )


def test_a_push_is_asked_about_what_stands_near_its_way() -> None:
    lessons = lessons_of([record()])
    assert lessons.goal.tolist() == [1]  # the other one is far away
    assert lessons.answer.tolist() == [1.0]


def test_what_left_the_table_was_not_freed() -> None:
    lessons = lessons_of([record(pushes=[(0, 0, 60, 30)])])
    assert lessons.goal.tolist() == [0]
    assert lessons.answer.tolist() == [0.0]


def test_a_stuck_table_is_asked_about_as_a_whole() -> None:
    lessons = lessons_of([record(), record(stuck=True)])
    assert lessons.goal.tolist() == [1, ALL, 1]
    assert lessons.answer.tolist() == [1.0, 0.5, 1.0]
    assert lessons.look.tolist() == [0, 1, 1]
    assert lessons.push.tolist() == [0, 1, 1]


@pytest.mark.parametrize("rotation", [0, 5, 12])
def test_a_question_is_the_picture_that_a_policy_is_shown(rotation: int) -> None:
    """Around the middle of the push's way, what `encode` and `pictures` make of the look."""
    row, col = 120, 110
    played = record(stuck=True, pushes=[(0, rotation, row, col)])
    lessons = lessons_of([played])
    cut, place = lessons.questions(np.flatnonzero(lessons.goal == ALL))
    goal = unpack_height(played.heights[0]) > RISE
    shown = Heightmap(
        workspace=Workspace(x_min=0.0, y_min=0.0, table_z=0.0),
        color=played.colors[0],
        height=unpack_height(played.heights[0]),
        goal=goal,
    )
    picture = pictures(state.encode(shown, goal=True))[rotation]
    start_row, start_col = to_picture(torch.tensor(rotation), torch.tensor(row), torch.tensor(col))
    half = PushNet.PATCH / 2
    middle = (place[0] * half + half - 0.5).double()  # x, y in the patch
    top = round(float(start_row - AHEAD - middle[1]))
    left = round(float(start_col - middle[0]))
    size = PushNet.PATCH
    rows = slice(max(0, top), min(FRAME, top + size))
    cols = slice(max(0, left), min(FRAME, left + size))
    inner = cut[0][:, rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
    torch.testing.assert_close(inner, picture[:, rows, cols])


def test_mirrored_questions_have_mirrored_places() -> None:
    lessons = lessons_of([record(pushes=[(0, 0, 150, 131)])])
    picks = np.zeros(64, np.intp)
    plain, place = lessons.questions(picks[:1])
    cuts, places = lessons.questions(picks, np.random.default_rng(0))
    mirrored = places[:, 0] != place[0, 0]
    assert 10 < mirrored.sum() < 54
    torch.testing.assert_close(places[mirrored, 0], -place[0, 0].expand(int(mirrored.sum())))
    for cut, turned in zip(cuts, mirrored, strict=True):
        expected = plain[0].flip(2) if turned else plain[0]
        for channel in (state.INSIDE, state.SEEN, state.HEIGHT, state.GOAL):
            torch.testing.assert_close(cut[channel], expected[channel])
        torch.testing.assert_close(
            cut[state.RED : state.GOAL].sum(0), expected[state.RED : state.GOAL].sum(0)
        )


def test_colours_are_changed_of_each_thing_for_itself() -> None:
    """Of all six orders, and not of both blocks and the table alike."""
    colors = {-1: (10, 20, 30), 0: (40, 50, 60), 1: (70, 80, 90)}
    played = record(pushes=[(0, 0, 150, 131)])
    for thing, color in colors.items():
        played.colors[0][played.owners[0] == thing] = color
    lessons = lessons_of([played])
    cuts, _ = lessons.questions(np.zeros(64, np.intp), np.random.default_rng(0))
    shown = cuts[:, state.RED : state.GOAL, ::8, ::8].flatten(2).permute(0, 2, 1) * 255
    orders = [
        [tuple(np.argsort(each).tolist()) for each in np.unique(cut.round(), axis=0) if each.any()]
        for cut in shown.numpy()
    ]
    assert len({order for each in orders for order in each}) == 6
    assert sum(len(set(each)) > 1 for each in orders) > 40
