"""The fingers of a simulated world as what the registers of an emulated 2F-85 move."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from tdpg_deploy.emulators.robotiq import JawsState
from tdpg_deploy.sim.gripper import (
    AT_GOAL,
    BLOCKED_STEPS,
    FORCES,
    HEADWAY,
    TREMBLE,
)
from tdpg_deploy.sim.physics import TIME_STEP
from tdpg_deploy.sim.world import World


@dataclass(frozen=True, kw_only=True)
class _Order:
    """Metres, metres a second, newtons."""

    width: float
    speed: float
    force: float


class WorldJaws:
    """`robotiq.Jaws`. Whoever steps the world calls `advance` before each step, in the world's
    thread; everything else may be called from the thread of a wire."""

    def __init__(self, world: World) -> None:
        self._robot = world.robot
        width = self._robot.width()
        self._order = _Order(width=width, speed=0.0, force=FORCES[1])
        self._state = JawsState(width=width, moving=False)
        self._target = width
        self._lately: deque[float] = deque(maxlen=BLOCKED_STEPS)
        self._lock = threading.Lock()

    def drive(self, width: float, *, speed: float, force: float) -> None:
        with self._lock:
            self._order = _Order(width=width, speed=speed, force=float(np.clip(force, *FORCES)))
            self._lately.clear()
            self._state = JawsState(width=self._state.width, moving=True)

    def halt(self) -> None:
        with self._lock:
            self._order = _Order(width=self._state.width, speed=0.0, force=self._order.force)

    def state(self) -> JawsState:
        with self._lock:
            return self._state

    def advance(self) -> None:
        """Measure what the last step of the world did, and drive the fingers through the next."""
        with self._lock:
            order, was_moving = self._order, self._state.moving
            width = self._robot.width()
            self._lately.append(width)
            moving = was_moving and not self._has_ended(order)
            self._state = JawsState(width=width, moving=moving)
        if not was_moving:
            self._target = width
        if moving:
            travel = np.clip(
                order.width - self._target, -order.speed * TIME_STEP, order.speed * TIME_STEP
            )
            self._target += float(travel)
            self._robot.drive_fingers(self._target, order.force)
        elif was_moving:
            self._robot.hold_fingers(order.width, order.force)

    def _has_ended(self, order: _Order) -> bool:
        """At the goal, or without headway for as long as the simulated gripper would wait."""
        if order.speed == 0.0:
            return True
        if len(self._lately) < BLOCKED_STEPS:
            return False
        last, before, first = self._lately[-1], self._lately[-2], self._lately[0]
        there = abs(last - order.width) < AT_GOAL
        return (there and abs(last - before) < TREMBLE * TIME_STEP) or abs(last - first) < HEADWAY
