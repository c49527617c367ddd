"""What a controller moves and feels."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from ur_analytic_ik import ur5

from tdpg_deploy.geometry import Array


class Plant(Protocol):
    """An arm and its surroundings, advanced by the controller in its own time."""

    @property
    def q(self) -> Array:
        """Joint positions (6,), rad, measured."""

    @property
    def force(self) -> Array:
        """(3,) N along the axes of base, as pressed on the tool by the world."""

    def drive(self, q_target: Array, dt: float) -> None:
        """Let `dt` seconds pass while the joints follow their targets (6,), rad."""


class KinematicPlant:
    """A UR5 that follows its targets exactly above a springy table, or above nothing."""

    TIP = np.array([0.0, 0.0, 0.163, 1.0])  # in the flange frame: closed 2F-85
    STIFFNESS = 5000.0  # N/m, as of a hard foam: 15 N at 3 mm

    def __init__(self, q: Array, *, table_z: float | None = None) -> None:
        self._q = np.array(q, np.float64)
        self._table_z = table_z

    @property
    def q(self) -> Array:
        return self._q.copy()

    @property
    def force(self) -> Array:
        if self._table_z is None:
            return np.zeros(3)
        tip = ur5.forward_kinematics(*self._q) @ self.TIP
        return np.array([0.0, 0.0, self.STIFFNESS * max(0.0, self._table_z - tip[2])])

    def drive(self, q_target: Array, dt: float) -> None:
        self._q = np.array(q_target, np.float64)
