"""A push or a grasp, and what is known of the table -> a plan for a UR arm with a 2F-85. Pure.

The tool frame lies between the *closed* finger tips, z down, x the closing direction. Fingers
that open swing up: every height here is that of closed tips, the lowest they ever are.

A plan is refused here only for want of knowledge, or of room; `safety.check` judges the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from policies.gripper import (
    CLOSED_GRIPPER,
    GRASP_DEPTH,
    MAX_UNKNOWN,
    OPEN_GRIPPER,
    OPEN_WIDTH,
    Part,
    have_room,
)
from policies.heightmap import Heightmap, Workspace
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy import kinematics
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.errors import PlanRefused
from tdpg_deploy.footprint import ground_under, rectangles
from tdpg_deploy.geometry import Array, Transform, top_down
from tdpg_deploy.plan import MoveFingers, MoveJoints, MoveLinear, Plan, Step

MIN_PUSH = 0.02  # m: less moves nothing
BACK_OUT = 0.015  # m back after a push: what it wedged between the fingers comes free of them
TOUCH_MARGIN = 0.02  # m over what was seen: depth, calibration and table_z err by less together
DESCENT = ("lower", "descend")  # names of the steps on the way down
LIFT_SPEED = 0.3  # m/s: blocks stay gripped, and joints turn slowly enough close to the base


def plan_primitive(primitive: Primitive, heightmap: Heightmap, config: CellConfig) -> Plan:
    """Steps that carry out `primitive` (base frame) from home and back.

    Raises PlanRefused when the ground under a finger is unknown or hardly lower than what it is to
    grasp, the tool cannot get above the spot, or no room is left for a push.
    """
    if not np.isfinite([primitive.x, primitive.y, primitive.z, primitive.yaw]).all():
        raise PlanRefused(f"{primitive} is not finite: no surface was seen there")
    if isinstance(primitive, Grasp):
        return _plan_grasp(primitive, heightmap, config)
    return _plan_push(primitive, heightmap, config)


def _plan_grasp(grasp: Grasp, heightmap: Heightmap, config: CellConfig) -> Plan:
    limits, table_z = config.limits, config.workspace.table_z
    surface = _surface(grasp, OPEN_GRIPPER, heightmap, config)
    if not have_room(grasp.z - table_z, surface):
        raise PlanRefused(
            f"what stands around keeps the finger tips {surface:.3f} m above the table, beside a "
            f"surface of {grasp.z - table_z:.3f} m: too little to grasp"
        )

    z = max(grasp.z - GRASP_DEPTH, table_z + surface + limits.table_clearance)
    q_above, yaw = _above(grasp.x, grasp.y, grasp.yaw, config)
    at_bin = top_down(*config.bin.position, yaw)
    return Plan(
        primitive=grasp,
        approach=(
            _fingers("open", OPEN_WIDTH, config),
            _joints("above", q_above, config),
            *_descent(top_down(grasp.x, grasp.y, z, yaw), surface, config),
            _fingers("close", 0.0, config),
            _lift(grasp.x, grasp.y, yaw, config),
        ),
        delivery=(
            _joints("over the bin", _joints_at("over the bin", at_bin, q_above, config), config),
            _fingers("release", OPEN_WIDTH, config),
        ),
        retreat=(_joints("home", np.array(config.arm.home), config),),
    )


def _plan_push(push: Push, heightmap: Heightmap, config: CellConfig) -> Plan:
    limits, table_z = config.limits, config.workspace.table_z
    surface = _surface(push, CLOSED_GRIPPER, heightmap, config)
    length = push.length
    notes: tuple[str, ...] = ()
    room = room_ahead(push, heightmap.workspace)
    if room < length:
        if room < MIN_PUSH:
            raise PlanRefused(
                f"push from ({push.x:.3f}, {push.y:.3f}) m towards {np.degrees(push.yaw):.0f} deg "
                f"has {room:.3f} m of room in the workspace, less than {MIN_PUSH} m"
            )
        notes = (f"push shortened from {push.length:.3f} to {room:.3f} m: the workspace ends",)
        length = room

    # Low enough to meet objects at their sides, yet above whatever the tips come down on.
    z = table_z + surface + limits.table_clearance
    back = _along(push, length - BACK_OUT)
    # Closing direction across the travel: the two fingers side by side make a broad front.
    q_above, yaw = _above(push.x, push.y, push.yaw + np.pi / 2, config)
    return Plan(
        primitive=push,
        approach=(
            _fingers("close", 0.0, config),
            _joints("above", q_above, config),
            *_descent(top_down(push.x, push.y, z, yaw), surface, config),
            _guarded("push", top_down(*_along(push, length), z, yaw), limits.push_force, config),
            _guarded("back", top_down(*back, z, yaw), limits.push_force, config),
            _lift(*back, yaw, config),
        ),
        retreat=(_joints("home", np.array(config.arm.home), config),),
        notes=notes,
    )


def _along(push: Push, length: float) -> tuple[float, float]:
    """x, y in base that far from its start."""
    return push.x + length * float(np.cos(push.yaw)), push.y + length * float(np.sin(push.yaw))


def plan_homing(X_base_tool: Transform, config: CellConfig) -> tuple[Step, ...]:
    """From wherever the tool is: straight up to travel height, then home."""
    home = _joints("home", np.array(config.arm.home), config)
    x, y, z = X_base_tool.translation
    if z >= _travel_z(config):
        return (home,)
    raised = Transform(X_base_tool.rotation, np.array([x, y, _travel_z(config)]))
    return _guarded("raise", raised, config.limits.push_force, config), home


# --- room -------------------------------------------------------------------------------------


def _surface(
    primitive: Primitive, parts: Sequence[Part], heightmap: Heightmap, config: CellConfig
) -> float:
    """Metres above the table below which the closed tips would meet something that was seen; what
    was not seen is as high as the table. Raises PlanRefused where the ground under the first part,
    which reaches lowest, is unknown."""
    surface = 0.0
    for part in parts:
        for place in rectangles(part, primitive):
            ground = ground_under(heightmap, place, clear_margin=config.limits.workspace_margin)
            if part is parts[0] and ground.unknown > MAX_UNKNOWN:
                raise PlanRefused(
                    f"{ground.unknown:.0%} of the ground under a finger at ({place.x:.3f}, "
                    f"{place.y:.3f}) m is unknown; at most {MAX_UNKNOWN:.0%} may be"
                )
            surface = float(np.fmax(surface, ground.highest - part.rise))
    return surface


def room_ahead(push: Push, workspace: Workspace) -> float:
    """Metres from the start to the border of the workspace, in the direction of the push."""
    room = np.inf
    for position, direction, low, high in (
        (push.x, np.cos(push.yaw), workspace.x_min, workspace.x_max),
        (push.y, np.sin(push.yaw), workspace.y_min, workspace.y_max),
    ):
        if abs(direction) > 1e-9:
            room = min(room, ((high if direction > 0 else low) - position) / direction)
    return max(float(room), 0.0)


# --- steps ------------------------------------------------------------------------------------


def _above(x: float, y: float, yaw: float, config: CellConfig) -> tuple[Array, float]:
    """Joints above a spot at travel height, and the yaw taken: the gripper is symmetric, so of
    yaw and yaw + pi the one that turns the arm less from home."""
    home = np.array(config.arm.home)
    ways = [
        (_joints_at("above", top_down(x, y, _travel_z(config), turned), home, config), turned)
        for turned in (yaw, yaw + np.pi)
    ]
    return min(ways, key=lambda way: float(np.abs(way[0] - home).max()))


def _joints_at(name: str, X_base_tool: Transform, q_near: Array, config: CellConfig) -> Array:
    """Joints (6,) that reach the pose without leaving the branch (shoulder, wrist, elbow) of
    home, so that no motion ever folds the arm over."""
    dh, X_tool_flange = config.arm.dh, config.arm.X_flange_tool.transform().inverse()
    branches = kinematics.inverse_batch(dh, (X_base_tool @ X_tool_flange).as_matrix())
    branch = kinematics.branch_of(dh, np.array(config.arm.home))
    q = kinematics.nearest(branches[[branch]], q_near, config.limits.joint_range)
    if q is None:
        raise _out_of_reach(name, X_base_tool)
    return q


def _out_of_reach(name: str, X_base_tool: Transform) -> PlanRefused:
    x, y, z = X_base_tool.translation
    return PlanRefused(
        f'waypoint "{name}" ({x:.3f}, {y:.3f}, {z:.3f}) m is out of reach or of the joints\' '
        "range; move the workspace closer or widen limits.joint_range"
    )


def _travel_z(config: CellConfig) -> float:
    return config.workspace.table_z + config.limits.travel_height


def _lift(x: float, y: float, yaw: float, config: CellConfig) -> MoveLinear:
    return MoveLinear(
        name="lift",
        X_base_tool=top_down(x, y, _travel_z(config), yaw),
        speed=min(LIFT_SPEED, config.limits.travel_speed),
        acceleration=config.limits.acceleration,
        stop_force=config.limits.push_force,
    )


def _descent(X_base_tool: Transform, surface: float, config: CellConfig) -> tuple[MoveLinear, ...]:
    """Down to a pose from travel height; slow from where a finger may touch down, since an arm
    presses on until it has felt the force and braked. surface: m above the table."""
    limits = config.limits
    touch_z = config.workspace.table_z + surface + TOUCH_MARGIN
    x, y, z = X_base_tool.translation
    descend = _guarded(DESCENT[1], X_base_tool, limits.descend_force, config)
    if limits.touch_speed >= limits.contact_speed or z >= touch_z:
        return (descend,)
    slow = replace(descend, speed=limits.touch_speed)
    if touch_z >= _travel_z(config):
        return (slow,)
    above = Transform(X_base_tool.rotation, np.array([x, y, touch_z]))
    return _guarded(DESCENT[0], above, limits.descend_force, config), slow


def _guarded(name: str, X_base_tool: Transform, force: float, config: CellConfig) -> MoveLinear:
    return MoveLinear(
        name=name,
        X_base_tool=X_base_tool,
        speed=config.limits.contact_speed,
        acceleration=config.limits.acceleration,
        stop_force=force,
    )


def _joints(name: str, q: Array, config: CellConfig) -> MoveJoints:
    return MoveJoints(
        name=name,
        q=q,
        speed=config.limits.joint_speed,
        acceleration=config.limits.joint_acceleration,
    )


def _fingers(name: str, width: float, config: CellConfig) -> MoveFingers:
    return MoveFingers(
        name=name, width=width, speed=config.gripper.speed, force=config.gripper.force
    )
