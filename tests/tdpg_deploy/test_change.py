from __future__ import annotations

import numpy as np
import pytest

from policies.heightmap import SIZE, Heightmap, Workspace
from policies.primitives import Grasp, Push
from tdpg_deploy.change import changed, gone
from tdpg_deploy.outcome import Verdict

WORKSPACE = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)
GRASP = Grasp(x=0.5, y=0.0, z=-0.10, yaw=0.0)
PUSH = Push(x=0.45, y=0.0, z=-0.15, yaw=0.0)


def seen(*blocks: tuple[float, float, float, float, float], noise: float = 0.0) -> Heightmap:
    """Blocks are x, y, side along x, side along y, height (m)."""
    height = np.random.default_rng(0).normal(0, noise, (SIZE, SIZE)).astype(np.float32)
    x, y = WORKSPACE.to_base(*np.indices((SIZE, SIZE)))
    for bx, by, sx, sy, h in blocks:
        height[(abs(x - bx) < sx / 2) & (abs(y - by) < sy / 2)] += h
    return Heightmap(workspace=WORKSPACE, color=np.zeros((SIZE, SIZE, 3), np.uint8), height=height)


CUBE = (0.5, 0.0, 0.05, 0.05, 0.05)
SMALLEST = (0.5, 0.0, 0.05, 0.05, 0.025)


@pytest.mark.parametrize("block", [CUBE, SMALLEST])
def test_a_block_taken_is_gone(block: tuple[float, float, float, float, float]) -> None:
    before, after = seen(block, noise=0.002), seen(noise=0.001)
    assert gone(before, after, GRASP) is Verdict.YES
    assert changed(before, after, GRASP) is Verdict.YES


def test_a_block_that_slid_or_fell_over_changed_but_is_not_gone() -> None:
    upright = (0.5, 0.0, 0.05, 0.05, 0.10)
    lying = (0.52, 0.02, 0.10, 0.05, 0.05)
    slid = (0.53, 0.0, 0.05, 0.05, 0.10)
    for after in (lying, slid):
        assert gone(seen(upright), seen(after), GRASP) is Verdict.NO
        assert changed(seen(upright), seen(after), GRASP) is Verdict.YES


def test_noise_is_no_change() -> None:
    before, after = seen(CUBE, noise=0.002), seen(CUBE, noise=0.0021)
    assert gone(before, after, GRASP) is Verdict.NO
    assert changed(before, after, PUSH) is Verdict.NO


def test_a_push_counts_along_its_whole_way_and_not_elsewhere() -> None:
    at_end = (0.55, 0.05, 0.05, 0.05, 0.05)
    moved = (0.58, 0.06, 0.05, 0.05, 0.05)
    assert changed(seen(at_end), seen(moved), PUSH) is Verdict.YES
    far = (0.5, 0.18, 0.05, 0.05, 0.05)
    assert changed(seen(far), seen(), PUSH) is Verdict.NO


def test_what_was_not_seen_is_not_judged() -> None:
    before, after = seen(CUBE), seen(CUBE)
    after.height[:] = np.nan
    assert gone(before, after, GRASP) is Verdict.UNKNOWN
    assert changed(before, after, PUSH) is Verdict.UNKNOWN


def test_a_hole_where_the_block_was_is_not_a_block_gone() -> None:
    before, after = seen(CUBE), seen()
    row, col = WORKSPACE.to_pixel(0.5, 0.0)
    after.height[row - 15 : row + 15, col - 15 : col + 15] = np.nan
    assert gone(before, after, GRASP) is not Verdict.YES
