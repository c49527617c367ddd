"""What a controller moves and feels: an arm of pure kinematics, or the simulated world's."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from tdpg_deploy.geometry import Array
from tdpg_deploy.kinematics import DhParameters, forward_batch


class Plant(Protocol):
    """An arm and its surroundings, advanced by the controller in its own time."""

    @property
    def dh(self) -> DhParameters:
        """Of the arm."""

    @property
    def q(self) -> Array:
        """Joint positions (6,), rad, measured."""

    @property
    def qd(self) -> Array:
        """Joint speeds (6,), rad/s, measured."""

    @property
    def force(self) -> Array:
        """(3,) N along the axes of base, as pressed on the tool by the world."""

    def drive(self, q_target: Array, dt: float) -> None:
        """Let `dt` seconds pass while the joints follow their targets (6,), rad."""


class KinematicPlant:
    """An arm that follows its targets exactly above a springy table, or above nothing."""

    TIP = np.array([0.0, 0.0, 0.163, 1.0])  # in the flange frame: closed 2F-85
    STIFFNESS = 20_000.0  # N/m, as of rubber tips on wood: 15 N at 0.75 mm

    def __init__(self, dh: DhParameters, q: Array, *, table_z: float | None = None) -> None:
        self.dh = dh
        self._q: Array = np.array(q, np.float64)
        self._qd: Array = np.zeros(6)
        self._table_z = table_z

    @property
    def q(self) -> Array:
        return self._q

    @property
    def qd(self) -> Array:
        return self._qd

    @property
    def force(self) -> Array:
        if self._table_z is None:
            return np.zeros(3)
        tip = forward_batch(self.dh, self._q) @ self.TIP
        return np.array([0.0, 0.0, self.STIFFNESS * max(0.0, self._table_z - tip[2])])

    def drive(self, q_target: Array, dt: float) -> None:
        self._qd = (q_target - self._q) / dt
        self._q = q_target
