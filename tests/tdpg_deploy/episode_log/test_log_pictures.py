"""Pictures show what was decided, where it is; the scene in 3D too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from synthetic_episode import WORKSPACE, Synthetic

from policies.heightmap import SIZE
from policies.policy import QMaps
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy.episode_log import pictures, plan_scene
from tdpg_deploy.episode_log.channels import Q_GRASP, Q_PUSH

PRIMITIVES: list[Primitive] = [
    Push(x=0.45, y=0.05, z=-0.1, yaw=np.pi / 2, length=0.1),
    Grasp(x=0.45, y=0.05, z=-0.1, yaw=np.pi / 2),
]


def drawn_pixels(primitive: Primitive) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    picture = np.full((2 * SIZE, 2 * SIZE, 3), 128, np.uint8)
    pictures.draw_action(picture, primitive, WORKSPACE)
    rows, cols = np.nonzero((picture != 128).any(axis=-1))
    return rows, cols


def test_a_push_is_drawn_along_its_way() -> None:
    """Towards base +y, which is left in the picture."""
    rows, cols = drawn_pixels(PRIMITIVES[0])
    row, col = (2 * int(v) + 1 for v in WORKSPACE.to_pixel(0.45, 0.05))
    _, end = (2 * int(v) + 1 for v in WORKSPACE.to_pixel(0.45, 0.15))
    assert abs(rows.mean() - row) < 2
    assert abs(cols.max() - col) < 6
    assert abs(cols.min() - end) < 6


def test_a_grasp_spans_the_open_hand_about_its_point() -> None:
    rows, cols = drawn_pixels(PRIMITIVES[1])
    row, col = (2 * int(v) + 1 for v in WORKSPACE.to_pixel(0.45, 0.05))
    assert abs((rows.max() + rows.min()) / 2 - row) < 2
    assert abs((cols.max() + cols.min()) / 2 - col) < 2
    assert abs((cols.max() - cols.min()) - 0.085 / 0.001) < 12  # and the ends of the fingers


@pytest.mark.parametrize("primitive", PRIMITIVES)
def test_an_action_beyond_the_border_does_not_fail(primitive: Primitive) -> None:
    pictures.draw_action(
        np.zeros((SIZE, SIZE, 3), np.uint8), replace(primitive, x=9.0, y=-9.0), WORKSPACE
    )


def test_the_goal_is_outlined_where_it_is() -> None:
    goal = np.zeros((SIZE, SIZE), np.bool_)
    goal[100:120, 50:90] = True
    picture = np.zeros((2 * SIZE, 2 * SIZE, 3), np.uint8)
    pictures.draw_goal(picture, goal)
    rows, cols = np.nonzero((picture == pictures.GOAL).all(axis=-1))
    assert abs(rows.min() - 200) <= 2
    assert abs(rows.max() - 239) <= 2
    assert abs(cols.min() - 100) <= 2
    assert abs(cols.max() - 179) <= 2
    assert not picture[210:230, 110:170].any()  # the goal itself stays to be seen


def test_q_maps_are_bright_where_values_are_high_and_grey_where_nothing_is_allowed() -> None:
    synthetic = Synthetic()
    blocks = synthetic.blocks(1)
    decision = synthetic.decision(blocks, push=False)
    shown = pictures.q_maps(synthetic.heightmap(blocks), decision)
    assert shown.keys() == {Q_PUSH, Q_GRASP}
    brightness = shown[Q_GRASP].astype(int).sum(axis=-1)
    best = brightness[2 * decision.row, 2 * decision.col]
    assert best > 4 * np.median(brightness)
    barred = shown[Q_PUSH][: 2 * 8 - 2]  # the rows that allow no push
    assert np.ptp(barred.astype(int), axis=-1).max() == 0


def test_maps_without_any_allowed_action_are_drawn_too() -> None:
    synthetic = Synthetic()
    blocks = synthetic.blocks(1)
    nothing = np.full((16, SIZE, SIZE), -np.inf, np.float32)
    decision = replace(
        synthetic.decision(blocks, push=False), maps=QMaps(push=nothing, grasp=nothing)
    )
    assert len(pictures.q_maps(synthetic.heightmap(blocks), decision)) == 2


@pytest.mark.parametrize("primitive", PRIMITIVES)
def test_the_scene_holds_the_action_and_its_path(primitive: Primitive) -> None:
    plan = Synthetic().plan(primitive)
    [entity] = plan_scene.scene(plan, 0.83, 7).entities
    path = [[point.x, point.y, point.z] for point in entity.lines[0].points]
    np.testing.assert_allclose(path, [[0.45, 0.05, 0.1], [0.45, 0.05, -0.14]])
    if isinstance(primitive, Push):
        [arrow] = entity.arrows
        assert arrow.shaft_length + arrow.head_length == pytest.approx(primitive.length)
        quaternion = arrow.pose.orientation
        yaw = 2 * np.arctan2(quaternion.z, quaternion.w)  # its +x axis is the arrow
        assert yaw == pytest.approx(primitive.yaw)
    else:
        ends = np.array([[point.x, point.y] for point in entity.lines[1].points])
        np.testing.assert_allclose(ends.mean(axis=0), [0.45, 0.05])
        np.testing.assert_allclose(ends[1] - ends[0], [0, 0.085], atol=1e-12)
    assert "q=0.83" in entity.texts[0].text


def test_poses_of_a_plan_are_its_straight_motions() -> None:
    plan = Synthetic().plan(PRIMITIVES[1])
    heights = [pose.position.z for pose in plan_scene.poses(plan, 7).poses]
    assert heights == [0.1, -0.14]


@pytest.mark.parametrize("x", [np.nan, np.inf, 1e300])
def test_an_action_that_is_nowhere_is_not_drawn(x: float) -> None:
    picture = np.zeros((448, 448, 3), np.uint8)
    pictures.draw_action(picture, Grasp(x=x, y=0.0, z=0.0, yaw=0.0), WORKSPACE)
    assert not picture.any()
