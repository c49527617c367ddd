"""The few calls that build bodies in a pybullet client, with settings that were seen to hold."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import pybullet
from scipy.spatial import HalfspaceIntersection

from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.sim.bodies import Shape
from tdpg_deploy.sim.pieces import ConvexPiece

TIME_STEP = 1 / 240  # s; longer steps lose grasps
SOLVER_ITERATIONS = 60  # 20 let six grasps in ten slip, 60 almost none
SOLVER_RESIDUAL = 1e-5  # ends the iteration early where little happens
GRAVITY = 9.81  # m/s^2

# Bullet multiplies the friction of a pair: wood (0.6) on rubber .72, on table .48, on wood .36.
PAD_FRICTION = 1.2
# m. A pad's rubber gives way and meets an edge on a patch, not a point: one of radius 4 mm resists
# turning by .6 of friction, force and radius, the soft finger of Kao and Cutkosky (1992). Bullet
# multiplies by the object's friction.
PAD_TORSION = 0.0029
TABLE_FRICTION = 0.8
HULL_MARGIN = 0.001  # m, how far Bullet's hulls reach beyond their corners
ROLLING_DAMPING = (
    0.99  # a share of the turning lost per second; rolling friction is ten times dearer
)


def connect() -> int:
    """A new world without a window, with gravity along -z. Returns its client id."""
    client: int = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -GRAVITY, physicsClientId=client)
    pybullet.setPhysicsEngineParameter(
        fixedTimeStep=TIME_STEP,
        numSolverIterations=SOLVER_ITERATIONS,
        solverResidualThreshold=SOLVER_RESIDUAL,
        contactBreakingThreshold=0.005,
        deterministicOverlappingPairs=1,
        physicsClientId=client,
    )
    return client


def add_static(client: int, piece: ConvexPiece, *, friction: float) -> int:
    """A piece that never moves, its vertices in base. Returns its body id."""
    body: int = pybullet.createMultiBody(
        baseMass=0,
        baseCollisionShapeIndex=collision_shape(client, [piece]),
        useMaximalCoordinates=True,  # else it never sleeps, and all that lies on it is collided
        physicsClientId=client,
    )
    pybullet.changeDynamics(body, -1, lateralFriction=friction, physicsClientId=client)
    return body


def add_object(
    client: int, shape: Shape, X_base_object: Transform, *, friction: float, density: float
) -> int:
    """A free body. density: kg/m^3. Returns its body id."""
    body: int = pybullet.createMultiBody(
        baseMass=density * shape.volume,
        baseCollisionShapeIndex=collision_shape(client, shape.pieces),
        basePosition=X_base_object.translation.tolist(),
        baseOrientation=X_base_object.rotation.as_quat().tolist(),
        useMaximalCoordinates=True,
        physicsClientId=client,
    )
    pybullet.changeDynamics(
        body,
        -1,
        lateralFriction=friction,
        restitution=0.0,
        angularDamping=ROLLING_DAMPING if shape.rolls else 0.04,
        activationState=pybullet.ACTIVATION_STATE_ENABLE_SLEEPING,
        physicsClientId=client,
    )
    return body


def collision_shape(client: int, pieces: Sequence[ConvexPiece]) -> int:
    """The union of convex pieces. -1, no shape, when there are none."""
    if not pieces:
        return -1
    hulls = [_core(piece) for piece in pieces]
    if len(hulls) == 1:
        shape: int = pybullet.createCollisionShape(
            pybullet.GEOM_MESH, vertices=hulls[0].tolist(), physicsClientId=client
        )
        return shape
    with tempfile.TemporaryDirectory(prefix="tdpg-") as folder:  # pybullet takes unions as files
        files = [Path(folder) / f"{number}.obj" for number in range(len(hulls))]
        for file, hull in zip(files, hulls, strict=True):
            file.write_text(_as_obj(hull))
        union: int = pybullet.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_MESH] * len(hulls),
            fileNames=[str(file) for file in files],
            physicsClientId=client,
        )
    return union


@lru_cache(maxsize=256)  # blocks and robot come back in each world, furniture may differ
def _core(piece: ConvexPiece) -> Array:
    """(n, 3) corners of the piece less Bullet's margin, so that contact happens at its faces."""
    inward = piece.planes + np.array([0, 0, 0, HULL_MARGIN])
    return HalfspaceIntersection(inward, piece.vertices.mean(axis=0)).intersections


def _as_obj(corners: Array) -> str:
    """Wavefront OBJ. pybullet takes the hull of all corners that some triangle names."""
    vertices = ["v {!r} {!r} {!r}".format(*corner) for corner in corners.tolist()]
    fan = [f"f 1 {i} {i + 1}" for i in range(2, len(vertices))]
    return "\n".join(vertices + fan) + "\n"
