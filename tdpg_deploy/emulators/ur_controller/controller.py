"""The state of a UR controller: modes, safety, registers, one program, one motion.

No sockets and no clocks: `cycle` is called once a control period, the servers around it call
the rest, and whoever plays the person at the pendant.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from tdpg_deploy.emulators.ur_controller.functions import functions
from tdpg_deploy.emulators.ur_controller.modes import (
    Generation,
    RobotMode,
    RuntimeState,
    SafetyMode,
)
from tdpg_deploy.emulators.ur_controller.motion import Motion, OutOfReach, solve
from tdpg_deploy.emulators.ur_controller.plant import Plant
from tdpg_deploy.emulators.ur_controller.script import Program, ScriptError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.kinematics import forward

_log = logging.getLogger(__name__)

JOINT_SPEED_LIMIT = 3.3  # rad/s: 180 degrees a second, and a little
FORCE_LIMIT = 150.0  # N at the tool, PolyScope's default safety setting
FORCE_LIMIT_AFTER = 0.1  # s; the real one reacts within 0.25 s (UR5 manual, safety functions)
SAFETY_DECELERATION = 20.0  # rad/s^2, of a protective, safeguard or emergency stop
IDLE_DECELERATION = 5.0  # rad/s^2, when a program ends while the arm moves
UNLOCK_AFTER = 5.0  # s; PolyScope lets nobody release a protective stop before


class Refused(Exception):
    """The controller does not do this now; the text says why, as the dashboard would."""


class Controller:
    """A controller with power on and brakes released, in remote control, running no program."""

    def __init__(self, plant: Plant, generation: Generation, *, pace: float = 1.0) -> None:
        """`pace`: seconds of the controller that pass in a second of its clients.

        A client's watchdog runs on the client's time.
        """
        self.plant, self.generation, self._pace = plant, generation, pace
        self.dt = 1 / generation.frequency
        self._boot(RobotMode.RUNNING)

    def _boot(self, mode: RobotMode) -> None:
        self.time = 0.0
        self.mode = mode
        self.safety = SafetyMode.NORMAL
        self.runtime = RuntimeState.STOPPED
        self.remote = True
        self.slider = 1.0
        self.claimed_by_fieldbus: frozenset[str] = frozenset()
        self.inputs: dict[str, float] = {}
        self.outputs: dict[str, float] = {}
        self.X_flange_tool = Transform.identity()
        self.payload = 0.0
        self.payload_cog: Array = np.zeros(3)
        self.motion: Motion | None = None
        self.q = self.q_target = self.plant.q
        self.qd: Array = np.zeros(6)
        self.force_bias: Array = np.zeros(3)
        self._force = self._over_force_limit = 0.0
        self._program: Program | None = None
        self._watchdog: tuple[str, float] | None = None
        self._written_at: dict[str, float] = {}
        self._stopped_at = -np.inf

    # --- measured -----------------------------------------------------------------------------

    @property
    def X_base_tool(self) -> Transform:
        return self.tool_at(self.q)

    @property
    def force(self) -> Array:
        return self.plant.force - self.force_bias

    @property
    def is_moving(self) -> bool:
        return bool(np.abs(self.qd).max() > 1e-4)

    def tool_at(self, q: npt.ArrayLike) -> Transform:
        """X_base_tool at joints (6,), with the TCP that is set."""
        return forward(self.plant.dh, q, self.X_flange_tool)

    def joints_at(self, X_base_tool: Transform, q_near: Array) -> Array:
        """Joints (6,) for a pose, in the branch closest to `q_near`. Raises OutOfReach."""
        return solve(self.plant.dh, self.X_flange_tool, X_base_tool, q_near)

    # --- the control cycle --------------------------------------------------------------------

    def cycle(self) -> None:
        """One control period."""
        self.time += self.dt
        self._check_watchdog()
        if self.runtime is RuntimeState.PLAYING:
            self._step_program()
        self._step_motion()
        self.plant.drive(self.q_target, self.dt)
        self.q, self.qd = self.plant.q, self.plant.qd
        self._check_force()

    def _step_program(self) -> None:
        assert self._program is not None
        try:
            self._program.step()
        except ScriptError as error:
            _log.warning("program stopped: %s", error)  # as a pendant's window would say
        if not self._program.alive:
            self.stop_program()

    def _step_motion(self) -> None:
        if self.motion is None:
            return
        try:
            target = self.motion.step(self.dt, self.slider, self.q_target)
        except OutOfReach as error:
            self.motion = None
            self.protective_stop(str(error))
            return
        if np.abs(target - self.q_target).max() > JOINT_SPEED_LIMIT * self.dt:
            self.motion = None
            self.protective_stop("a joint exceeds its speed limit")
            return
        self.q_target = target
        if self.motion.done and self.runtime is not RuntimeState.PAUSED:
            self.motion = None

    def _check_force(self) -> None:
        before, self._force = self._force, float(np.linalg.norm(self.plant.force))
        pressed = self.is_moving and self._force > max(FORCE_LIMIT, 0.99 * before)
        self._over_force_limit = self._over_force_limit + self.dt if pressed else 0.0
        if self._over_force_limit > FORCE_LIMIT_AFTER:
            self.protective_stop("the force at the tool exceeds the safety limit")

    # --- programs -----------------------------------------------------------------------------

    def upload(self, source: str) -> None:
        """Start a program in place of the one that runs; refused silently, as by a real one."""
        if not (self.is_ready and self.remote):
            _log.info("script ignored: %s, %s", self.mode.name, self.safety.name)
            return
        self.stop_program()
        try:
            self._program = Program(source, functions(self))
        except ScriptError as error:
            _log.info("script refused: %s", error)
            return
        self.runtime = RuntimeState.PLAYING

    @property
    def is_ready(self) -> bool:
        return self.mode is RobotMode.RUNNING and self.safety is SafetyMode.NORMAL

    @property
    def program_name(self) -> str:
        return self._program.name if self._program else "<unnamed>"

    def stop_program(self) -> None:
        if self._program:
            self._program.kill()
        self._program = self._watchdog = None
        self.runtime = RuntimeState.STOPPED
        self.brake(IDLE_DECELERATION)

    def pause_program(self) -> None:
        if self.runtime is RuntimeState.PLAYING:
            self.runtime = RuntimeState.PAUSED

    def play(self) -> None:
        """Go on with a paused program, and with its motion. Raises Refused."""
        if not self.is_ready or self.runtime is not RuntimeState.PAUSED:
            raise Refused("Failed to execute: play")
        if self.motion:
            self.motion.resume()
        self.runtime = RuntimeState.PLAYING

    def brake(self, deceleration: float) -> None:
        if self.motion:
            self.motion.brake(deceleration)

    # --- inputs and watchdog ------------------------------------------------------------------

    def write_inputs(self, values: Mapping[str, Any]) -> None:
        self.inputs.update(values)
        self._written_at.update(dict.fromkeys(values, self.time))

    def set_watchdog(self, name: str, frequency: float) -> None:
        """Stop the program when `name` is written less often than `frequency`, Hz."""
        self._watchdog = (name, self._pace / frequency)
        self._written_at[name] = self.time

    def _check_watchdog(self) -> None:
        if self._watchdog and self.runtime is RuntimeState.PLAYING:
            name, allowed = self._watchdog
            if self.time - self._written_at[name] > allowed:
                _log.info("program stopped by its watchdog on %s", name)
                self.stop_program()

    # --- safety -------------------------------------------------------------------------------

    def protective_stop(self, cause: str) -> None:
        if self.safety is SafetyMode.NORMAL:
            _log.info("protective stop: %s", cause)
            self._safety_stop(SafetyMode.PROTECTIVE_STOP)

    def safeguard_stop(self) -> None:
        self._safety_stop(SafetyMode.SAFEGUARD_STOP)

    def emergency_stop(self) -> None:
        self._safety_stop(SafetyMode.ROBOT_EMERGENCY_STOP)
        self.power_off()

    def _safety_stop(self, mode: SafetyMode) -> None:
        self.safety, self._stopped_at = mode, self.time
        self.brake(SAFETY_DECELERATION)
        self.pause_program()

    def unlock_protective_stop(self) -> None:
        """Raises Refused within five seconds of the stop."""
        if self.time - self._stopped_at < UNLOCK_AFTER:
            raise Refused(
                "Cannot unlock protective stop until 5s after occurrence. "
                "Always inspect cause of protective stop before unlocking"
            )
        if self.safety is SafetyMode.PROTECTIVE_STOP:
            self.safety = SafetyMode.NORMAL

    def release_stop(self) -> None:
        """Safeguard closed, or e-stop button pulled out.

        After a safeguard stop without reset button, a paused program goes on by itself.
        """
        was, self.safety = self.safety, SafetyMode.NORMAL
        if was is SafetyMode.SAFEGUARD_STOP and self.runtime is RuntimeState.PAUSED:
            self.play()

    def power_off(self) -> None:
        self.stop_program()
        self.brake(SAFETY_DECELERATION)
        self.mode = RobotMode.POWER_OFF

    def power_on(self) -> None:
        if self.mode is RobotMode.POWER_OFF and self.safety is SafetyMode.NORMAL:
            self.mode = RobotMode.IDLE

    def release_brakes(self) -> None:
        if self.mode is RobotMode.IDLE:
            self.mode = RobotMode.RUNNING

    def set_remote(self, remote: bool) -> None:
        if not remote:
            self.stop_program()
        self.remote = remote

    def reboot(self, mode: RobotMode = RobotMode.POWER_OFF) -> None:
        """Modes, registers and set-up as after start-up; the arm where it is."""
        self._boot(mode)
