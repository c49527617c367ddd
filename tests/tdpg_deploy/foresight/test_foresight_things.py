from __future__ import annotations

import numpy as np
import pytest
from seen import CONFIG, seen

from policies.heightmap import SIZE, Heightmap
from tdpg_deploy.foresight.things import things
from tdpg_deploy.workspace import workspace_of
from tools.evaluate.tables import challenge_cases

RED, BLUE = (200, 60, 30), (40, 70, 180)
LEFT, RIGHT = (slice(90, 120), slice(80, 110)), (slice(90, 120), slice(110, 140))


def two(
    colors: tuple[tuple[int, int, int], tuple[int, int, int]] = (RED, RED),
    heights: tuple[float, float] = (0.05, 0.05),
    *,
    goal: bool = False,
) -> Heightmap:
    """Two blocks of 60 x 60 mm, side by side."""
    color, height = np.full((SIZE, SIZE, 3), 90, np.uint8), np.zeros((SIZE, SIZE), np.float32)
    for place, rgb, top in zip((LEFT, RIGHT), colors, heights, strict=True):
        color[place], height[place] = rgb, top
    mask = np.zeros((SIZE, SIZE), np.bool_)
    mask[LEFT] = True
    return Heightmap(
        workspace=workspace_of(CONFIG), color=color, height=height, goal=mask if goal else None
    )


@pytest.mark.parametrize(
    "heightmap",
    [two((RED, BLUE)), two(heights=(0.05, 0.025)), two(goal=True)],
    ids=["color", "height", "goal"],
)
def test_blocks_that_touch_are_two(heightmap: Heightmap) -> None:
    found = things(heightmap)
    assert found.max() == 2
    assert found[105, 95] != found[105, 125]
    for place in (LEFT, RIGHT):  # but for the border, where blurred edges meet
        inner = found[place][2:-2, 2:-2]
        assert (inner == inner[0, 0]).all()
    assert not found[:, :78].any()
    assert not found[:, 142:].any()


def test_of_one_colour_and_height_they_are_one() -> None:
    found = things(two())
    assert found.max() == 1
    assert np.count_nonzero(found) >= 0.99 * 30 * 60


def test_nothing_stands_on_an_empty_table() -> None:
    assert not things(two(heights=(0.0, 0.0))).any()


def test_no_thing_lies_on_both_sides_of_the_goal_s_border() -> None:
    heightmap = two(goal=True)
    found = things(heightmap)
    assert heightmap.goal is not None
    assert not set(found[heightmap.goal].tolist()) & (set(found[~heightmap.goal].tolist()) - {0})


@pytest.mark.slow
@pytest.mark.parametrize("table", challenge_cases(), ids=lambda table: table.name)
def test_what_the_camera_shows_of_a_block_is_a_thing(table: object) -> None:
    shown = seen(table.scene(CONFIG, 4_000, goal=True))  # type: ignore[attr-defined]
    found = things(shown.heightmap)
    for index in range(len(shown.scene.objects)):
        of_block = shown.owners == index
        if np.count_nonzero(of_block) < 150:
            continue  # what is below a tower
        best = np.bincount(found[of_block]).argmax()
        both = np.count_nonzero(of_block & (found == best))
        either = np.count_nonzero((of_block | (found == best)) & (shown.owners >= 0))
        assert best > 0
        assert both / either > 0.8
