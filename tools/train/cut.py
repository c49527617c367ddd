"""What is shown of stored looks around actions."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from policies.heightmap import SIZE
from tools.train.replay import UNSEEN, unpack_height

METRES = unpack_height(np.arange(int(UNSEEN) + 1, dtype=np.uint16))  # of every packed height

Pixel = TypeVar("Pixel", np.uint16, np.uint8, np.int8)


def cut(
    maps: npt.NDArray[Pixel],
    look: npt.NDArray[np.intp],
    index: npt.NDArray[np.int64],
    outside: int,
) -> npt.NDArray[Pixel]:
    """maps: (n, 224, 224, ...). look: (m,) which of them an action is of. index: (m, h, w) which
    of its pixels are shown, as rotation.around has them. outside: where none is."""
    padded = np.full((len(maps), SIZE * SIZE + 1, *maps.shape[3:]), outside, maps.dtype)
    padded[:, :-1] = maps.reshape(len(maps), SIZE * SIZE, *maps.shape[3:])
    return np.stack([padded[i, at] for i, at in zip(look, index, strict=True)])
