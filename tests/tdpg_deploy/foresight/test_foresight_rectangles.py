from __future__ import annotations

import numpy as np
import numpy.typing as npt
from hypothesis import given
from hypothesis import strategies as st

from tdpg_deploy.foresight.rectangles import rectangle

SIDE = 120
ROWS, COLS = np.mgrid[:SIDE, :SIDE]


def filled(
    col: float, row: float, sides: tuple[float, float], turn: float
) -> npt.NDArray[np.bool_]:
    """The pixels whose middles lie in a rectangle."""
    u = (COLS - col) * np.cos(turn) + (ROWS - row) * np.sin(turn)
    v = (ROWS - row) * np.cos(turn) - (COLS - col) * np.sin(turn)
    inside: npt.NDArray[np.bool_] = (np.abs(u) < sides[0] / 2) & (np.abs(v) < sides[1] / 2)
    return inside


PLACES = st.floats(50, 70)
SIDES = st.tuples(st.floats(12, 25), st.floats(26, 50))
TURNS = st.floats(0, np.pi)


@given(PLACES, PLACES, SIDES, TURNS)
def test_it_is_found_as_well_as_pixels_tell(
    col: float, row: float, sides: tuple[float, float], turn: float
) -> None:
    corners = rectangle(filled(col, row, sides, turn))
    assert corners is not None
    assert np.abs(corners.mean(axis=0) - (col, row)).max() <= 0.5
    ways = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    assert np.abs(np.sort(ways[:2]) - sides).max() <= 1.01


def test_noise_at_its_border_costs_a_quarter_of_a_pixel() -> None:
    """Each pixel of the border is there or not; the corners are gone."""
    rng = np.random.default_rng(0)
    off = []
    for _ in range(20):
        col, row, turn = *rng.uniform(55, 65, 2), rng.uniform(0, np.pi)
        inner, outer = (filled(col, row, (24 + d, 48 + d), turn) for d in (-1, 1))
        shown = inner | (outer & (rng.random(outer.shape) < 0.5))
        shown &= np.hypot(COLS - col, ROWS - row) < 25.5
        corners = rectangle(shown)
        assert corners is not None
        off.append(np.abs(corners.mean(axis=0) - (col, row)).max())
    assert np.sqrt(np.mean(np.square(off))) < 0.25


def test_a_disc_and_a_triangle_are_none() -> None:
    assert rectangle(np.hypot(COLS - 60, ROWS - 60) < 13) is None
    assert rectangle((COLS > 40) & (ROWS > 40) & (COLS + ROWS < 110)) is None
