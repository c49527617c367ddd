"""What a dataset says of each feature, for those who normalise by it. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Stats = dict[str, Any]


def of_vectors(values: Sequence[npt.ArrayLike]) -> Stats:
    """Of numbers or vectors, one a frame; along the frames."""
    table = np.asarray(values, np.float64).reshape(len(values), -1)
    return {
        "min": table.min(axis=0).tolist(),
        "max": table.max(axis=0).tolist(),
        "mean": table.mean(axis=0).tolist(),
        "std": table.std(axis=0).tolist(),
        "count": [len(table)],
        **{name: np.quantile(table, q, axis=0).tolist() for name, q in QUANTILES.items()},
    }


class PictureStats:
    """Of pictures, by channel and over all pixels, on a scale of 0 to 1. Exact: it counts how
    often each of the 256 values was seen."""

    def __init__(self) -> None:
        self._counts = np.zeros((3, 256), np.int64)
        self._pictures = 0

    def add(self, picture: npt.NDArray[np.uint8]) -> None:
        """(H, W, 3) uint8."""
        self._pictures += 1
        for channel in range(3):
            self._counts[channel] += np.bincount(picture[..., channel].ravel(), minlength=256)

    def stats(self) -> Stats:
        values = np.arange(256) / 255
        seen = self._counts > 0
        share = self._counts / self._counts.sum(axis=1, keepdims=True)
        mean = share @ values
        below = share.cumsum(axis=1)
        columns = {
            "min": values[seen.argmax(axis=1)],
            "max": values[255 - seen[:, ::-1].argmax(axis=1)],
            "mean": mean,
            "std": np.sqrt((share * (values - mean[:, None]) ** 2).sum(axis=1)),
            **{name: values[(below >= q).argmax(axis=1)] for name, q in QUANTILES.items()},
        }
        shaped = {name: column.reshape(3, 1, 1).tolist() for name, column in columns.items()}
        return {**shaped, "count": [self._pictures]}
