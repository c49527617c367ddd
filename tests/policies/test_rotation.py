from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from policies.heightmap import SIZE, Workspace
from policies.policy import ROTATIONS
from policies.rotation import (
    FRAME,
    back_to_map,
    patches,
    pictures,
    positions,
    sample,
    to_map,
    to_picture,
    yaw_of,
)

WORKSPACE = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)
rotations = st.integers(0, ROTATIONS - 1)
pixels = st.integers(0, SIZE - 1)


def integers(*values: int) -> tuple[torch.Tensor, ...]:
    return tuple(torch.tensor([value]) for value in values)


@given(rotations, st.integers(60, 160), st.integers(60, 160))
def test_what_lies_ahead_of_the_action_lies_above_it_in_the_picture(
    k: int, row: int, col: int
) -> None:
    x, y = WORKSPACE.to_base(row, col)
    ahead_x, ahead_y = x + 0.08 * np.cos(yaw_of(k)), y + 0.08 * np.sin(yaw_of(k))
    ahead_row = (WORKSPACE.x_max - ahead_x) / 0.002 - 0.5
    ahead_col = (WORKSPACE.y_max - ahead_y) / 0.002 - 0.5
    here = to_picture(*integers(k, row, col))
    ahead = to_picture(torch.tensor([k]), torch.tensor([ahead_row]), torch.tensor([ahead_col]))
    assert here[0].item() - ahead[0].item() == pytest.approx(40)
    assert here[1].item() == pytest.approx(ahead[1].item())


@given(rotations, pixels, pixels)
def test_a_pixel_comes_back_to_its_place_and_never_leaves_the_picture(
    k: int, row: int, col: int
) -> None:
    there = to_picture(*integers(k, row, col))
    back = to_map(torch.tensor([k]), *there)
    assert back[0].item() == pytest.approx(row)
    assert back[1].item() == pytest.approx(col)
    assert all(1 <= place.item() <= FRAME - 2 for place in there)


@pytest.mark.parametrize("k", range(ROTATIONS))
def test_pictures_agree_with_scipy(k: int) -> None:
    image = np.random.default_rng(k).random((SIZE, SIZE)).astype(np.float32)
    margin = (FRAME - SIZE) // 2
    expected = ndimage.rotate(np.pad(image, margin), -np.rad2deg(yaw_of(k)), reshape=False, order=0)
    picture = pictures(torch.from_numpy(image)[None])[k, 0].numpy()
    # Places half-way between two pixels may fall to either.
    assert np.mean(picture != expected) < 0.002


@pytest.mark.parametrize("k", range(ROTATIONS))
def test_a_marked_pixel_is_found_again(k: int) -> None:
    rng = np.random.default_rng(k)
    for row, col in rng.integers(4, SIZE - 4, (5, 2)):
        mark = torch.zeros(1, SIZE, SIZE)
        mark[0, row - 2 : row + 3, col - 2 : col + 3] = 1
        found = back_to_map(pictures(mark))[k, 0].numpy()
        assert ndimage.center_of_mass(found) == pytest.approx((row, col), abs=0.5)
        if k % 4 == 0:
            np.testing.assert_allclose(found, mark[0].numpy(), atol=1e-4)


def test_values_come_back_from_any_stride() -> None:
    # A value that is linear in the place is kept exactly by bilinear interpolation.
    side = torch.arange(SIZE, dtype=torch.float64)
    rows, cols = to_picture(torch.arange(ROTATIONS)[:, None, None], side[:, None], side)
    for stride in (2, 8):
        centers = (torch.arange(FRAME // stride) + 0.5) * stride - 0.5
        values = (centers[:, None] + 2 * centers).expand(ROTATIONS, 1, -1, -1).float()
        inside = (torch.minimum(rows, cols) > stride) & (
            torch.maximum(rows, cols) < FRAME - 1 - stride
        )
        error = back_to_map(values)[:, 0] - (rows + 2 * cols)
        assert error[inside].abs().max() < 2e-3


def test_patches_are_cut_from_the_pictures() -> None:
    generator = torch.Generator().manual_seed(1)
    state = torch.rand((3, SIZE, SIZE), generator=generator)
    whole = pictures(state)
    k = torch.randint(ROTATIONS, (40,), generator=generator)
    rows = torch.randint(SIZE, (40,), generator=generator)
    cols = torch.randint(SIZE, (40,), generator=generator)
    size, stride = 96, 8
    cuts, places = patches(state.expand(40, -1, -1, -1), k, rows, cols, size=size, stride=stride)
    exact = to_picture(k, rows, cols)
    for i, (cut, place) in enumerate(zip(cuts, places, strict=True)):
        in_cut = ((place.double() + 1) * size / 2 - 0.5).flip(0)
        top, left = (round(float(exact[a][i] - in_cut[a])) for a in (0, 1))
        assert top % stride == 0
        assert left % stride == 0
        padded = torch.nn.functional.pad(whole[k[i]], (size,) * 4)
        torch.testing.assert_close(
            cut, padded[:, top + size : top + 2 * size, left + size : left + 2 * size]
        )


def test_sample_reads_what_comes_back_to_the_map() -> None:
    generator = torch.Generator().manual_seed(2)
    values = torch.rand((ROTATIONS, 2, 40, 40), generator=generator)
    k, rows, cols = torch.tensor([0, 3, 9]), torch.tensor([0, 100, 223]), torch.tensor([5, 7, 223])
    expected = back_to_map(values)[k, :, rows, cols]
    torch.testing.assert_close(sample(values[k], positions(k, rows, cols)), expected)
