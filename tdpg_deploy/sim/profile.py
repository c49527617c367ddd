"""Trapezoidal speed profiles. Pure."""

from __future__ import annotations

import numpy as np

from tdpg_deploy.geometry import Array


def trapezoid(length: float, speed: float, acceleration: float, step: float) -> Array:
    """(n,) share of the way covered after each time step, growing to exactly 1 at rest.

    length, speed, acceleration in one unit of way (m, rad) and seconds; all above zero, or
    length 0 for an empty profile.
    """
    if length <= 0:
        return np.empty(0)
    ramp = min(speed / acceleration, np.sqrt(length / acceleration))  # s of speeding up
    top = ramp * acceleration
    duration = length / top + ramp
    t = np.minimum(np.arange(1, int(np.ceil(duration / step)) + 1) * step, duration)
    starting = acceleration * t**2 / 2
    cruising = top * (t - ramp / 2)
    ending = length - acceleration * (duration - t) ** 2 / 2
    covered = np.where(t < ramp, starting, np.where(t < duration - ramp, cruising, ending))
    share: Array = covered / length
    share[-1] = 1.0
    return share
