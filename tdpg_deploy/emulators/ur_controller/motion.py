"""Trajectories of the controller: along a path with limited speed and acceleration.

Each motion is stepped once a control cycle and gives the joint targets of that cycle.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.kinematics import DhParameters, inverse, nearest

Solve: TypeAlias = Callable[[Transform, Array], Array]  # of `solve`, for one arm and tool

JOINT_RANGE = (-2 * np.pi, 2 * np.pi)


class OutOfReach(Exception):
    """The path leaves what the arm can reach."""


def solve(
    dh: DhParameters, X_flange_tool: Transform, X_base_tool: Transform, q_near: Array
) -> Array:
    """Joints (6,) for a pose, in the branch closest to `q_near`. Raises OutOfReach."""
    q = nearest(inverse(dh, X_base_tool, X_flange_tool), q_near, JOINT_RANGE)
    if q is None:
        raise OutOfReach(f"no joint positions put the tool at {X_base_tool.translation} m")
    return q


class Path(Protocol):
    """`length` in rad or m; the joints at a place `s` along it, near `q_near`."""

    length: float

    def at(self, s: float, q_near: Array) -> Array: ...


class JointPath:
    """Straight in joint space; length is that of the leading axis, rad."""

    def __init__(self, start: Array, end: Array) -> None:
        self._start, self._end = start, end
        self.length = float(np.abs(end - start).max())

    def at(self, s: float, q_near: Array) -> Array:
        share = s / self.length if self.length else 1.0
        return self._start + share * (self._end - self._start)


class LinearPath:
    """Straight in space, turning evenly; length in m, or in rad for a turn on the spot."""

    def __init__(self, start: Transform, end: Transform, solve: Solve) -> None:
        distance, angle = start.distance(end)
        self.length = distance if distance > 1e-6 else angle
        self._start, self._end, self._solve = start, end, solve
        self._turn = (end.rotation * start.rotation.inv()).as_rotvec()

    def at(self, s: float, q_near: Array) -> Array:
        share = s / self.length if self.length else 1.0
        step = self._end.translation - self._start.translation
        turned = Rotation.from_rotvec(share * self._turn) * self._start.rotation
        pose = Transform(turned, self._start.translation + share * step)
        return self._solve(pose, q_near)


class Motion(Protocol):
    """`done` once the target is reached or the motion has been braked to rest."""

    done: bool

    def step(self, dt: float, slider: float, q: Array) -> Array:
        """Joint targets after dt seconds more, from targets `q`, at a share of the speed."""

    def brake(self, deceleration: float) -> None:
        """Come to rest at `deceleration` of the leading axis, rad/s^2."""

    def resume(self) -> None:
        """Go on after `brake`."""


class PathMotion:
    """Along a path: accelerate, travel, come to rest at the end."""

    def __init__(self, path: Path, *, speed: float, acceleration: float) -> None:
        self._path, self._speed, self._acceleration = path, speed, acceleration
        self._s = self._v = 0.0
        self._joint_speed = 0.0
        self._braking: float | None = None
        self.done = False

    def brake(self, deceleration: float) -> None:
        along_path = self._v / self._joint_speed if self._joint_speed > 1e-6 else 1.0
        self._braking = deceleration * along_path

    def resume(self) -> None:
        self._braking = None
        self.done = False

    def step(self, dt: float, slider: float, q: Array) -> Array:
        left = self._path.length - self._s
        if self._braking is not None:
            self._v = max(0.0, self._v - self._braking * dt)
            self.done = self._v == 0.0
        else:
            a = self._acceleration
            wanted = min(self._speed * slider, float(np.sqrt(2 * a * left)))
            self._v = min(self._v + a * dt, max(wanted, self._v - 2 * a * dt))
        if self._v * dt >= left:
            self._s, self._v, self.done = self._path.length, 0.0, True
        else:
            self._s += self._v * dt
        target = self._path.at(self._s, q)
        self._joint_speed = float(np.abs(target - q).max()) / dt
        return target


class SpeedMotion:
    """A joint speed held until it is changed; `wanted` gives it (6,) rad/s at joints (6,)."""

    def __init__(self, wanted: Callable[[Array], Array], *, acceleration: float) -> None:
        self.wanted, self.acceleration = wanted, acceleration
        self._qd: Array = np.zeros(6)
        self._braking = False
        self.done = False

    def brake(self, deceleration: float) -> None:
        self._braking, self.acceleration = True, deceleration

    def resume(self) -> None:
        self._braking = self.done = False

    def step(self, dt: float, slider: float, q: Array) -> Array:
        target = np.zeros(6) if self._braking else self.wanted(q) * slider
        change = target - self._qd
        largest = float(np.abs(change).max())
        allowed = self.acceleration * dt
        self._qd = target if largest <= allowed else self._qd + change * (allowed / largest)
        self.done = self._braking and not self._qd.any()
        return q + self._qd * dt
