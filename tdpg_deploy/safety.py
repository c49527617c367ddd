"""The gate that every plan passes before anything moves, in the simulated and the real cell.

`check` follows the plan from home, samples every path and raises PlanRefused at the first
waypoint that breaks a rule:

1. Every number is finite; speeds, accelerations and forces stay within the cell's limits.
2. The arm reaches all of every path, each joint stays in its range, the elbow stays high, and
   no joint has to turn faster than the arm's can (near a singularity it would).
3. Over the workspace, joint motions stay at travel height and linear motions clear of the
   table. Outside of it nothing goes lower than the bin. A linear motion below travel height
   stops on force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from tdpg_deploy import kinematics
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.errors import PlanRefused
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import DOF
from tdpg_deploy.plan import MoveFingers, MoveJoints, MoveLinear, Plan, Step

MAX_JOINT_SPEED = np.pi  # rad/s, UR5 and UR5e user manuals: all joints 180 deg/s
ELBOW_CLEARANCE = 0.10  # m between the table and the elbow's axis; the arm is 0.06 m thick there
SAG = 0.04  # m that a joint motion may dip under travel height between two poses at it
MAX_FINGER_FORCE = 235.0  # N, 2F-85 manual
_STEP = 0.01  # m between samples of a linear path
_TURN = 0.05  # rad between samples of a joint path
_ROUNDING = 1e-6  # m


def check(plan: Plan, config: CellConfig) -> None:
    """Raises PlanRefused that names waypoint, place, rule and remedy. Takes about a millisecond.

    Both ways through the plan are checked: with the delivery, and without.
    """
    home = np.array(config.arm.home)
    q_lifted = check_steps(plan.approach, home, config)
    check_steps(plan.retreat, q_lifted, config, first=len(plan.approach) + len(plan.delivery))
    if plan.delivery:
        q_bin = check_steps(plan.delivery, q_lifted, config, first=len(plan.approach))
        check_steps(plan.retreat, q_bin, config, first=len(plan.approach) + len(plan.delivery))


def check_steps(steps: Sequence[Step], q: Array, config: CellConfig, *, first: int = 0) -> Array:
    """Follow `steps` from joints q (6,); the joints in which they end. Waypoints are counted
    from `first`. Raises PlanRefused."""
    for number, step in enumerate(steps, start=first):
        label = f'waypoint {number} "{step.name}"'
        _check_numbers(step, label, config)
        if isinstance(step, MoveJoints):
            path = _joint_path(q, step, config)
        elif isinstance(step, MoveLinear):
            path = _linear_path(q, step, label, config)
        else:
            continue
        _check_path(path, step, label, config)
        q = path.q[-1]
    return q


# --- numbers ----------------------------------------------------------------------------------


def _check_numbers(step: Step, label: str, config: CellConfig) -> None:
    limits = config.limits
    if isinstance(step, MoveFingers):
        if not 0 <= step.width < np.inf:
            raise PlanRefused(f"{label} has width {step.width} m; pads cannot stand so")
        _require_up_to(label, "force", step.force, MAX_FINGER_FORCE, "N")
        _require_up_to(label, "speed", step.speed, config.gripper.speed, "m/s")
    elif isinstance(step, MoveJoints):
        if np.shape(step.q) != (DOF,) or not np.isfinite(step.q).all():
            raise PlanRefused(f"{label} has joints {step.q}; six finite angles are needed")
        _require_up_to(label, "speed", step.speed, limits.joint_speed, "rad/s")
        _require_up_to(
            label, "acceleration", step.acceleration, limits.joint_acceleration, "rad/s^2"
        )
    else:
        _require_up_to(label, "speed", step.speed, limits.travel_speed, "m/s")
        _require_up_to(label, "acceleration", step.acceleration, limits.acceleration, "m/s^2")
        if step.stop_force is not None:
            highest = max(limits.descend_force, limits.push_force)
            _require_up_to(label, "stop force", step.stop_force, highest, "N")


def _require_up_to(label: str, name: str, value: float, high: float, unit: str) -> None:
    if not 0 < value <= high:  # also false for nan
        raise PlanRefused(
            f"{label} has {name} {value} {unit}, outside (0, {high:.3f}]; see limits and gripper "
            "in the cell file"
        )


# --- paths ------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class _Path:
    """q: (n, 6) rad. position: (n, 3) of the tool in base, m."""

    q: Array
    position: Array


def _joint_path(q: Array, step: MoveJoints, config: CellConfig) -> _Path:
    samples = _samples(float(np.abs(step.q - q).max()) / _TURN)
    joints = q + samples[:, None] * (step.q - q)
    flanges = kinematics.forward_batch(config.arm.dh, joints)
    tools = flanges @ config.arm.X_flange_tool.transform().as_matrix()
    return _Path(q=joints, position=tools[:, :3, 3])


def _linear_path(q: Array, step: MoveLinear, label: str, config: CellConfig) -> _Path:
    dh, X_flange_tool = config.arm.dh, config.arm.X_flange_tool.transform()
    start, end = kinematics.forward(dh, q, X_flange_tool), step.X_base_tool
    length, angle = start.distance(end)
    samples = _samples(max(length / _STEP, angle / _TURN))
    tools = _interpolate(start, end, samples)
    flanges = tools @ X_flange_tool.inverse().as_matrix()
    joints = kinematics.inverse_batch(dh, flanges)[:, kinematics.branch_of(dh, q)]

    reached = np.isfinite(joints).all(axis=1)
    if not reached.all():
        at = _at(tools[int(np.argmin(reached)), :3, 3])
        raise PlanRefused(f"{label}: the path leaves the arm's reach at {at}; move the workspace")
    joints = np.unwrap(joints, axis=0).astype(np.float64)
    joints += 2 * np.pi * np.round((q - joints[0]) / (2 * np.pi))

    seconds = max(length / step.speed, angle / config.limits.joint_speed) / (len(samples) - 1)
    if seconds > 0:
        turn_rate = np.abs(np.diff(joints, axis=0)) / seconds
        index, joint = np.unravel_index(int(turn_rate.argmax()), turn_rate.shape)
        if turn_rate[index, joint] > MAX_JOINT_SPEED:
            raise PlanRefused(
                f"{label}: at {_at(tools[index, :3, 3])} joint {joint} would have to turn at "
                f"{turn_rate[index, joint]:.1f} rad/s, more than {MAX_JOINT_SPEED:.2f}: the arm "
                "passes a singularity; move the workspace"
            )
    return _Path(q=joints, position=tools[:, :3, 3])


def _samples(count: float) -> Array:
    return np.linspace(0.0, 1.0, max(2, int(np.ceil(count)) + 1), dtype=np.float64)


def _interpolate(start: Transform, end: Transform, samples: Array) -> Array:
    """(n, 4, 4): straight in space, turning evenly."""
    tools: Array = np.tile(np.eye(4), (len(samples), 1, 1))
    turn = Slerp([0.0, 1.0], Rotation.concatenate([start.rotation, end.rotation]))
    tools[:, :3, :3] = turn(samples).as_matrix()
    tools[:, :3, 3] = start.translation + samples[:, None] * (end.translation - start.translation)
    return tools


def _check_path(path: _Path, step: MoveJoints | MoveLinear, label: str, config: CellConfig) -> None:
    limits, workspace = config.limits, config.workspace
    low, high = limits.joint_range
    if not ((path.q >= low) & (path.q <= high)).all():
        joint = int(np.abs(path.q).max(axis=0).argmax())
        raise PlanRefused(
            f"{label} turns joint {joint} to {path.q[-1, joint]:.2f} rad, outside "
            f"limits.joint_range [{low:.2f}, {high:.2f}]"
        )
    elbow = float(kinematics.elbow_height(config.arm.dh, path.q).min()) - workspace.table_z
    if elbow < ELBOW_CLEARANCE:
        raise PlanRefused(
            f"{label} brings the elbow to {elbow:.3f} m above the table, less than "
            f"{ELBOW_CLEARANCE} m; change arm.home to a raised elbow"
        )

    _check_heights(path, step, label, config)


def _check_heights(
    path: _Path, step: MoveJoints | MoveLinear, label: str, config: CellConfig
) -> None:
    limits, workspace = config.limits, config.workspace
    travel_z = workspace.table_z + limits.travel_height
    height = path.position[:, 2]
    if isinstance(step, MoveJoints):
        floor_over = travel_z - SAG
    else:
        floor_over = workspace.table_z + limits.table_clearance
        if step.stop_force is None and height.min() < travel_z - _ROUNDING:
            raise PlanRefused(
                f"{label} goes below travel height z {travel_z:.3f} m without stop_force"
            )

    over = _over_workspace(path.position, config)
    floor = np.where(over, floor_over, min(travel_z, config.bin.position[2]))
    too_low = height < floor - _ROUNDING
    if not too_low.any():
        return
    index = int(too_low.argmax())
    place = f"{label} {_at(path.position[index])}"
    if over[index]:
        raise PlanRefused(
            f"{place} is lower over the table than z {floor[index]:.3f} m; check "
            "workspace.table_z and limits"
        )
    (x_min, x_max), (y_min, y_max) = workspace.x_range, workspace.y_range
    raise PlanRefused(
        f"{place} lies outside the workspace x [{x_min:.3f}, {x_max:.3f}], y [{y_min:.3f}, "
        f"{y_max:.3f}] and lower than z {floor[index]:.3f} m; check X_base_camera"
    )


def _over_workspace(position: Array, config: CellConfig) -> npt.NDArray[np.bool_]:
    """(n,) whether points (n, 3) in base lie over the workspace."""
    (x_min, x_max), (y_min, y_max) = config.workspace.x_range, config.workspace.y_range
    x, y = position[:, 0], position[:, 1]
    inside: npt.NDArray[np.bool_] = (
        (x >= x_min - _ROUNDING)
        & (x <= x_max + _ROUNDING)
        & (y >= y_min - _ROUNDING)
        & (y <= y_max + _ROUNDING)
    )
    return inside


def _at(position: Array) -> str:
    return "({:.3f}, {:.3f}, {:.3f}) m".format(*position)
