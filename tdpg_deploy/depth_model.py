"""What a stereo camera's depth is off by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, kw_only=True)
class DepthModel:
    """z = 1 / (a / z_measured + b). b in 1/m.

    What is measured is disparity, so that an error of scale and one of a constant number of
    pixels both take this form.
    """

    a: float = 1.0
    b: float = 0.0

    def correct(self, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Metres in, metres out, nan stays nan."""
        return (depth / (self.a + self.b * depth)).astype(np.float32)
