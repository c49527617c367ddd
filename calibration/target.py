"""The ChArUco board: what is printed, and where its corners are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array


@dataclass(frozen=True, kw_only=True)
class CharucoTarget:
    """columns x rows squares of `square` metres, with markers of `marker` metres inside the
    white ones. The board's frame: origin at the outer corner of the top left square, x along a
    row, y down, z into the board.

    dictionary: a predefined ArUco dictionary's name. legacy: as printed before OpenCV 4.6,
    which with an even number of rows starts with a white square.
    """

    columns: int = 9
    rows: int = 6
    square: float = 0.028
    marker: float = 0.021
    dictionary: str = "DICT_5X5_100"
    legacy: bool = False

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 30 and 3 <= self.rows <= 30):
            raise CalibrationError(
                f"a board of {self.columns} x {self.rows} squares: give 3 to 30 each way"
            )
        if not 0.002 <= self.square <= 1.0:
            raise CalibrationError(
                f"squares of {self.square} m: give 0.002 to 1 m"
                f"{'; is that in mm?' if self.square > 1 else ''}"
            )
        if not 0.4 * self.square <= self.marker <= 0.9 * self.square:
            raise CalibrationError(
                f"markers of {self.marker} m in squares of {self.square} m: "
                "give 0.4 to 0.9 of the square"
            )

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in metres."""
        return self.columns * self.square, self.rows * self.square

    def corners(self) -> Array:
        """(n, 3) metres: inner corners by id, row by row."""
        y, x = np.mgrid[1 : self.rows, 1 : self.columns]
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
        return np.asarray(flat * self.square, np.float64)

    def white_squares(self) -> Array:
        """(n, 2) middles of the white squares, metres."""
        y, x = np.mgrid[0 : self.rows, 0 : self.columns]
        odd = 0 if self.legacy and self.rows % 2 == 0 else 1
        white = (x + y) % 2 == odd
        return np.asarray((np.stack([x[white], y[white]], axis=1) + 0.5) * self.square)


DEFAULT_TARGET = CharucoTarget()
