"""A plan as things to draw in 3D, in the base frame."""

from __future__ import annotations

import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive

from policies.gripper import OPEN_WIDTH
from policies.primitives import Primitive, Push
from tdpg_deploy.episode_log.channels import BASE
from tdpg_deploy.episode_log.messages import timestamp, vector
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.plan import MoveLinear, Plan

PUSH_COLOR = Color(r=0.95, g=0.45, b=0.10, a=1)
GRASP_COLOR = Color(r=0.15, g=0.65, b=0.95, a=1)
PATH_COLOR = Color(r=0.9, g=0.9, b=0.9, a=0.8)


def poses(plan: Plan, time: int) -> PosesInFrame:
    """X_base_tool of every straight motion; joint motions have no pose in a plan."""
    return PosesInFrame(
        timestamp=timestamp(time), frame_id=BASE, poses=[_pose(X) for X in _waypoints(plan)]
    )


def scene(plan: Plan, q: float, time: int) -> SceneUpdate:
    """The primitive, its value, and the path. Replaces the scene of the plan before."""
    primitive = plan.primitive
    p = np.array([primitive.x, primitive.y, primitive.z])
    color = PUSH_COLOR if isinstance(primitive, Push) else GRASP_COLOR
    entity = SceneEntity(
        timestamp=timestamp(time),
        frame_id=BASE,
        id="plan",
        lines=[_line([X.translation for X in _waypoints(plan)], PATH_COLOR, 0.003)],
        spheres=[SpherePrimitive(pose=_at(p), size=vector([0.012] * 3), color=color)],
        texts=[
            TextPrimitive(
                pose=_at(p + np.array([0, 0, 0.08])),
                billboard=True,
                font_size=0.02,
                color=color,
                text=f"{type(primitive).__name__.lower()} q={q:.2f}",
            )
        ],
    )
    if isinstance(primitive, Push):
        entity.arrows.append(_arrow(p, primitive, color))
    else:
        half = OPEN_WIDTH / 2 * _direction(primitive)
        entity.lines.append(_line([p - half, p + half], color, 0.008))
    return SceneUpdate(entities=[entity])


def _waypoints(plan: Plan) -> list[Transform]:
    steps = (*plan.approach, *plan.delivery, *plan.retreat)
    return [step.X_base_tool for step in steps if isinstance(step, MoveLinear)]


def _direction(primitive: Primitive) -> Array:
    return np.array([np.cos(primitive.yaw), np.sin(primitive.yaw), 0.0])


def _arrow(p: Array, push: Push, color: Color) -> ArrowPrimitive:
    head = 0.025
    w, z = np.cos(push.yaw / 2), np.sin(push.yaw / 2)
    return ArrowPrimitive(
        pose=Pose(position=vector(p), orientation=Quaternion(x=0, y=0, z=z, w=w)),
        shaft_length=max(push.length - head, 0.001),
        shaft_diameter=0.008,
        head_length=head,
        head_diameter=0.02,
        color=color,
    )


def _line(points: list[Array], color: Color, thickness: float) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitive.LINE_STRIP,
        pose=_at(np.zeros(3)),
        thickness=thickness,
        points=[Point3(x=x, y=y, z=z) for x, y, z in points],
        color=color,
    )


def _at(p: Array) -> Pose:
    return Pose(position=vector(p), orientation=Quaternion(x=0, y=0, z=0, w=1))


def _pose(X: Transform) -> Pose:
    x, y, z, w = X.rotation.as_quat()
    return Pose(position=vector(X.translation), orientation=Quaternion(x=x, y=y, z=z, w=w))
