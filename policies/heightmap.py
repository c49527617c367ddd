"""The state that a policy sees, and the sole place where pixels become metres.

A heightmap is the workspace seen straight from above, by someone who stands at the robot:
up in the picture is base +x (away from the robot), left is base +y. Seen so, nothing is
mirrored: counter-clockwise in the picture is counter-clockwise about base z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from policies.errors import HeightmapError

SIZE = 224  # pixels a side (paper, section III)
PIXEL = 0.002  # metres a pixel (paper, section IV; VPG)
RIM = 40  # pixels around the map; a gripper that works at its border reaches as far
WIDE = SIZE + 2 * RIM
INSIDE = slice(RIM, RIM + SIZE)  # of the rows and columns of a wide map


@dataclass(frozen=True, kw_only=True)
class Workspace:
    """The square of table that a heightmap covers. Base frame, metres.

    x_min, y_min: its lowest corner. table_z: height of the table's surface.
    """

    x_min: float
    y_min: float
    table_z: float

    @property
    def side(self) -> float:
        return SIZE * PIXEL

    @property
    def x_max(self) -> float:
        return self.x_min + self.side

    @property
    def y_max(self) -> float:
        return self.y_min + self.side

    @property
    def middle(self) -> tuple[float, float]:
        """x, y in base (m)."""
        return self.x_min + self.side / 2, self.y_min + self.side / 2

    def to_base(
        self, row: npt.ArrayLike, col: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Centres of pixels -> x, y in base (m). Fractional pixels are allowed."""
        x = self.x_max - (np.asarray(row, np.float64) + 0.5) * PIXEL
        y = self.y_max - (np.asarray(col, np.float64) + 0.5) * PIXEL
        return x, y

    def to_pixel(
        self, x: npt.ArrayLike, y: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """x, y in base (m) -> row, column of the pixel that holds the point (may lie outside)."""
        row = np.floor((self.x_max - np.asarray(x, np.float64)) / PIXEL).astype(np.intp)
        col = np.floor((self.y_max - np.asarray(y, np.float64)) / PIXEL).astype(np.intp)
        return row, col

    def contains(self, x: float, y: float, *, margin: float = 0.0) -> bool:
        """Whether the point lies in the square, at least `margin` metres from its border."""
        return (
            self.x_min + margin <= x <= self.x_max - margin
            and self.y_min + margin <= y <= self.y_max - margin
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Heightmap:
    """One look at the workspace.

    color:  (224, 224, 3) uint8 RGB, zero where unseen.
    height: (224, 224) float32, metres above the table, nan where unseen.
    goal:   (224, 224) bool, pixels of the object to fetch; None when clearing the table.
    rim:    (304, 304) float32, like height, for RIM pixels around the map, which itself is left
            out (nan). No policy is shown it: it is for fingers, which must come down on nothing
            there either. None when nothing is known of it.
    """

    workspace: Workspace
    color: npt.NDArray[np.uint8]
    height: npt.NDArray[np.float32]
    goal: npt.NDArray[np.bool_] | None = None
    rim: npt.NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        _require("color", self.color, (SIZE, SIZE, 3), np.uint8)
        _require("height", self.height, (SIZE, SIZE), np.float32)
        if self.goal is not None:
            _require("goal", self.goal, (SIZE, SIZE), np.bool_)
        if self.rim is not None:
            _require("rim", self.rim, (WIDE, WIDE), np.float32)

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """(224, 224) bool: True where the surface was seen. A hole is never table."""
        return np.isfinite(self.height)

    @property
    def wide(self) -> npt.NDArray[np.float32]:
        """(304, 304) float32: height and rim."""
        wide: npt.NDArray[np.float32] = np.pad(self.height, RIM, constant_values=np.nan)
        return wide if self.rim is None else np.where(np.isnan(wide), self.rim, wide)


def _require(
    name: str, array: npt.NDArray[np.generic], shape: tuple[int, ...], dtype: type[np.generic]
) -> None:
    if array.shape != shape or array.dtype != dtype:
        raise HeightmapError(
            f"Heightmap.{name} must be {shape} {np.dtype(dtype)}, got {array.shape} {array.dtype}"
        )
