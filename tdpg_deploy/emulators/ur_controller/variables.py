"""RTDE variables: name, type, and where a controller has the value.

What is not simulated (currents, temperatures, digital lines) reads as a quiet arm would.
Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from tdpg_deploy.emulators.ur_controller.controller import Controller
from tdpg_deploy.emulators.ur_controller.modes import robot_status_bits, safety_status_bits
from tdpg_deploy.emulators.ur_controller.rtde_wire import FieldType, Value
from tdpg_deploy.geometry import Transform

Read: TypeAlias = Callable[[Controller], Value]

JOINT_RUNNING = 253  # joint_mode


def _pose(X: Transform) -> list[float]:
    return list(X.as_rotation_vector())


def _tool_speed(c: Controller) -> list[float]:
    before = c.X_base_tool
    after = c.tool_at(c.q + c.qd * c.dt)
    turn = (after.rotation * before.rotation.inv()).as_rotvec()
    return list(np.concatenate([after.translation - before.translation, turn]) / c.dt)


def _constant(value: Value) -> Read:
    return lambda _: value


_ZEROS = _constant([0.0] * 6)
_UINT32, _INT32, _UINT64 = FieldType.UINT32, FieldType.INT32, FieldType.UINT64
_DOUBLE, _VECTOR3D, _VECTOR6D = FieldType.DOUBLE, FieldType.VECTOR3D, FieldType.VECTOR6D

_OUTPUTS: dict[str, tuple[FieldType, Read]] = {
    "timestamp": (_DOUBLE, lambda c: c.time),
    "target_q": (_VECTOR6D, lambda c: c.q_target.tolist()),
    "target_qd": (_VECTOR6D, lambda c: c.qd.tolist()),
    "target_qdd": (_VECTOR6D, _ZEROS),
    "target_current": (_VECTOR6D, _ZEROS),
    "target_moment": (_VECTOR6D, _ZEROS),
    "actual_q": (_VECTOR6D, lambda c: c.q.tolist()),
    "actual_qd": (_VECTOR6D, lambda c: c.qd.tolist()),
    "actual_current": (_VECTOR6D, _ZEROS),
    "joint_control_output": (_VECTOR6D, _ZEROS),
    "actual_TCP_pose": (_VECTOR6D, lambda c: _pose(c.X_base_tool)),
    "actual_TCP_speed": (_VECTOR6D, _tool_speed),
    "actual_TCP_force": (_VECTOR6D, lambda c: [*c.force.tolist(), 0.0, 0.0, 0.0]),
    "target_TCP_pose": (_VECTOR6D, lambda c: _pose(c.tool_at(c.q_target))),
    "target_TCP_speed": (_VECTOR6D, _tool_speed),
    "actual_digital_input_bits": (_UINT64, _constant(0)),
    "joint_temperatures": (_VECTOR6D, _constant([30.0] * 6)),
    "actual_execution_time": (_DOUBLE, _constant(0.0)),
    "robot_mode": (_INT32, lambda c: c.mode),
    "joint_mode": (FieldType.VECTOR6INT32, _constant([JOINT_RUNNING] * 6)),
    "safety_mode": (_INT32, lambda c: c.safety),
    "actual_tool_accelerometer": (_VECTOR3D, _constant([0.0, 0.0, -9.82])),
    "speed_scaling": (_DOUBLE, lambda c: c.slider if c.is_ready else 0.0),
    "target_speed_fraction": (_DOUBLE, lambda c: c.slider),
    "actual_momentum": (_DOUBLE, _constant(0.0)),
    "actual_main_voltage": (_DOUBLE, _constant(48.0)),
    "actual_robot_voltage": (_DOUBLE, _constant(48.0)),
    "actual_robot_current": (_DOUBLE, _constant(0.5)),
    "actual_joint_voltage": (_VECTOR6D, _constant([48.0] * 6)),
    "actual_digital_output_bits": (_UINT64, _constant(0)),
    "runtime_state": (_UINT32, lambda c: c.runtime),
    "standard_analog_input0": (_DOUBLE, _constant(0.0)),
    "standard_analog_input1": (_DOUBLE, _constant(0.0)),
    "standard_analog_output0": (_DOUBLE, _constant(0.0)),
    "standard_analog_output1": (_DOUBLE, _constant(0.0)),
    "robot_status_bits": (_UINT32, lambda c: robot_status_bits(c.mode, c.runtime)),
    "safety_status_bits": (_UINT32, lambda c: safety_status_bits(c.safety)),
    "payload": (_DOUBLE, lambda c: c.payload),
    "payload_cog": (_VECTOR3D, lambda c: c.payload_cog.tolist()),
    "payload_inertia": (_VECTOR6D, _ZEROS),
}
_SINCE_5 = {"ft_raw_wrench": (_VECTOR6D, lambda c: [*c.force.tolist(), 0.0, 0.0, 0.0])}
_REGISTER_TYPES = {"int": FieldType.INT32, "double": FieldType.DOUBLE}


def _register(name: str, direction: str) -> FieldType | None:
    match = re.fullmatch(rf"{direction}_(int|double)_register_(\d+)", name)
    return _REGISTER_TYPES[match[1]] if match and int(match[2]) < 48 else None


def output(name: str, major: int) -> tuple[FieldType, Read] | None:
    """Type and reader of an output variable on controllers of this major version."""
    kind = _register(name, "output")
    if kind is not None:
        return kind, lambda c: c.outputs.get(name, 0)
    return _OUTPUTS.get(name) or (_SINCE_5.get(name) if major >= 5 else None)


def input_type(name: str) -> FieldType | None:
    """Type of an input variable; `external_force_torque` is taken and ignored."""
    if name == "external_force_torque":
        return FieldType.VECTOR6D
    return _register(name, "input")
