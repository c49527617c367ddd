"""URScript's built-in functions on a controller: what programs, ur_rtde's among them, call.

A generator takes control cycles; a plain function takes none.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tdpg_deploy.emulators.ur_controller.motion import (
    JointPath,
    LinearPath,
    Motion,
    OutOfReach,
    PathMotion,
    SpeedMotion,
)
from tdpg_deploy.emulators.ur_controller.script import Pose, ScriptError, Steps
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.kinematics import forward

if TYPE_CHECKING:
    from tdpg_deploy.emulators.ur_controller.controller import Controller

_log = logging.getLogger(__name__)

_KILLED_DECELERATION = 5.0  # rad/s^2, when the thread that moves the arm is killed
_SERVO_ACCELERATION = 150.0  # rad/s^2: a target that jumps meets the speed limit first
_NOT_EMULATED = (
    *("force_mode", "end_force_mode", "servoc", "movec", "tool_contact", "get_joint_torques"),
    *("freedrive_mode", "end_freedrive_mode", "teach_mode", "end_teach_mode", "direct_torque"),
)


class Functions:
    """Each public method is a function of URScript by that name."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    # --- time and arithmetic ------------------------------------------------------------------

    def sync(self) -> Steps:
        yield

    def sleep(self, seconds: float) -> Steps:
        end = self._controller.time + seconds
        while self._controller.time < end:
            yield

    def textmsg(self, *parts: object) -> None:
        _log.debug("%s", " ".join(map(str, parts)))

    def norm(self, values: Sequence[float]) -> float:
        return float(np.linalg.norm(values))

    def pose_trans(self, a: Pose, b: Pose) -> Pose:
        return _pose(_transform(a) @ _transform(b))

    def pose_sub(self, a: Pose, b: Pose) -> Pose:
        X_a, X_b = _transform(a), _transform(b)
        turn = (X_a.rotation * X_b.rotation.inv()).as_rotvec()
        return Pose([*(X_a.translation - X_b.translation), *turn])

    # --- motion -------------------------------------------------------------------------------

    def movej(
        self, target: Sequence[float], a: float = 1.4, v: float = 1.05, t: float = 0, r: float = 0
    ) -> Steps:
        """Blends (`r`) come to rest at their waypoint; a time (`t`) is not followed."""
        start, end = self._controller.q_target, self._joints(target)
        yield from self._move(PathMotion(JointPath(start, end), speed=v, acceleration=a))

    def movel(
        self, target: Sequence[float], a: float = 1.2, v: float = 0.25, t: float = 0, r: float = 0
    ) -> Steps:
        c = self._controller
        end = _transform(target) if isinstance(target, Pose) else c.tool_at(target)
        c.joints_at(end, c.q_target)  # a program ends at a pose that has no solution
        path = LinearPath(c.tool_at(c.q_target), end, c.joints_at)
        yield from self._move(PathMotion(path, speed=v, acceleration=a))

    movep = movel

    def stopj(self, a: float) -> Steps:
        self._controller.brake(a)
        while self._controller.motion:
            yield

    def stopl(self, a: float, aRot: float = 0) -> Steps:
        """Along the path like stopj; `a` in m/s^2 at half a metre's reach is twice that."""
        yield from self.stopj(2 * a)

    def speedj(self, qd: Sequence[float], a: float = 0.5, t: float = 0) -> Steps:
        yield from self._speed(lambda _: np.asarray(qd, np.float64), a, t)

    def speedl(self, xd: Sequence[float], a: float = 0.25, t: float = 0) -> Steps:
        c = self._controller

        def wanted(q: Array) -> Array:
            pose = c.tool_at(q)
            turn = type(pose.rotation).from_rotvec(np.asarray(xd[3:]) * c.dt)
            after = Transform(turn * pose.rotation, pose.translation + np.asarray(xd[:3]) * c.dt)
            return (c.joints_at(after, q) - q) / c.dt

        yield from self._speed(wanted, 2 * a, t)

    def servoj(
        self,
        q: Sequence[float],
        a: float = 0,
        v: float = 0,
        t: float = 0.002,
        lookahead_time: float = 0.1,
        gain: float = 300,
    ) -> Steps:
        """Follows its targets late by `lookahead_time`, whatever the gain; a real arm's lag
        depends on both."""
        target = np.asarray(q, np.float64)
        yield from self._speed(lambda q: (target - q) / lookahead_time, _SERVO_ACCELERATION, t)

    def _speed(self, wanted: Callable[[Array], Array], a: float, t: float) -> Steps:
        c = self._controller
        if isinstance(c.motion, SpeedMotion):
            c.motion.wanted, c.motion.acceleration = wanted, a
            c.motion.resume()
        else:
            c.motion = SpeedMotion(wanted, acceleration=a)
        end = c.time + max(t, c.dt / 2)
        while c.time < end:
            yield

    def _move(self, motion: Motion) -> Steps:
        c = self._controller
        c.motion = motion
        try:
            while c.motion is motion:
                yield
        finally:
            if c.motion is motion:
                c.brake(_KILLED_DECELERATION)

    # --- registers ----------------------------------------------------------------------------

    def read_input_integer_register(self, i: int) -> float:
        return self._controller.inputs.get(f"input_int_register_{i}", 0)

    def read_input_float_register(self, i: int) -> float:
        return self._controller.inputs.get(f"input_double_register_{i}", 0.0)

    def write_output_integer_register(self, i: int, value: int) -> None:
        self._controller.outputs[f"output_int_register_{i}"] = int(value)

    def write_output_float_register(self, i: int, value: float) -> None:
        self._controller.outputs[f"output_double_register_{i}"] = float(value)

    def rtde_set_watchdog(self, name: str, frequency: float, action: str = "pause") -> None:
        """Whatever the action, the program is stopped."""
        self._controller.set_watchdog(name, frequency)

    # --- kinematics ---------------------------------------------------------------------------

    def get_inverse_kin(
        self, pose: Pose, qnear: Sequence[float] | None = None, *tolerances: float
    ) -> list[float]:
        near: Array = self._controller.q if qnear is None else np.asarray(qnear, np.float64)
        return list(self._controller.joints_at(_transform(pose), near))

    def get_inverse_kin_has_solution(self, pose: Pose, *arguments: Any) -> bool:
        try:
            self.get_inverse_kin(pose, *arguments)
        except OutOfReach:
            return False
        return True

    def get_forward_kin(self, q: Sequence[float] | None = None, tcp: Pose | None = None) -> Pose:
        c = self._controller
        X_flange_tool = c.X_flange_tool if tcp is None else _transform(tcp)
        return _pose(forward(c.plant.dh, c.q if q is None else q, X_flange_tool))

    def is_within_safety_limits(self, target: Sequence[float]) -> bool:
        return not isinstance(target, Pose) or self.get_inverse_kin_has_solution(target)

    # --- state --------------------------------------------------------------------------------

    def get_actual_tcp_pose(self) -> Pose:
        return _pose(self._controller.X_base_tool)

    def get_actual_tool_flange_pose(self) -> Pose:
        return self.get_forward_kin(tcp=_pose(Transform.identity()))

    def get_actual_joint_positions(self) -> list[float]:
        return list(self._controller.q)

    def get_target_tcp_speed(self) -> list[float]:
        c = self._controller
        after = c.tool_at(c.q + c.qd * c.dt)
        return [step / c.dt for step in self.pose_sub(_pose(after), _pose(c.X_base_tool))]

    def get_tcp_force(self) -> list[float]:
        return [*self._controller.force, 0.0, 0.0, 0.0]

    def is_steady(self) -> bool:
        return not self._controller.is_moving

    def get_steptime(self) -> float:
        return self._controller.dt

    # --- set-up -------------------------------------------------------------------------------

    def set_tcp(self, pose: Pose) -> None:
        self._controller.X_flange_tool = _transform(pose)

    def get_tcp_offset(self) -> Pose:
        return _pose(self._controller.X_flange_tool)

    def set_payload(self, mass: float, cog: Sequence[float], inertia: object = None) -> None:
        self._controller.payload = float(mass)
        self._controller.payload_cog = np.asarray(cog, np.float64)

    set_target_payload = set_payload

    def get_target_payload(self) -> float:
        return self._controller.payload

    def get_target_payload_cog(self) -> list[float]:
        return list(self._controller.payload_cog)

    def zero_ftsensor(self) -> None:
        self._controller.force_bias = self._controller.plant.force

    def protective_stop(self) -> None:
        self._controller.protective_stop("asked for by the program")

    def force_mode_set_damping(self, damping: float) -> None:
        """Without effect: force mode is not emulated, and programs set it up all the same."""

    force_mode_set_gain_scaling = force_mode_set_damping

    def _joints(self, target: Sequence[float]) -> Array:
        if isinstance(target, Pose):
            return self._controller.joints_at(_transform(target), self._controller.q)
        return np.asarray(target, np.float64)


def functions(controller: Controller) -> dict[str, Callable[..., Any]]:
    """What a program on this controller can call, by name."""
    bound = Functions(controller)
    emulated = {n: getattr(bound, n) for n in vars(Functions) if not n.startswith("_")}
    return emulated | {name: partial(_refuse, name) for name in _NOT_EMULATED}


def _refuse(name: str, *_arguments: object, **_named: object) -> None:
    raise ScriptError(f"{name} is not emulated; docs/emulate.md says what is")


def _transform(pose: Sequence[float]) -> Transform:
    return Transform.from_rotation_vector(pose)


def _pose(X: Transform) -> Pose:
    return Pose(X.as_rotation_vector().tolist())
