"""What carries the gripper: the arm, or for training a gantry of rails that is cheaper to simulate.

A carrier is geometry only. It turns motions of the arm into rows of its own joints'
positions, (n, k) in m and rad, one row a time step; `Robot` drives them.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from tdpg_deploy.errors import ArmError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.kinematics import DhParameters, forward_batch, inverse_batch
from tdpg_deploy.sim.links import (
    GANTRY_HEIGHT,
    Link,
    arm_links,
    gantry_links,
    wrist_flange,
)

MAX_JOINT_STEP = 0.05  # rad a time step, 12 rad/s: more means that the way meets a singularity


class Carrier(Protocol):
    links: tuple[Link, ...]
    X_wrist_flange: Transform  # from the last link

    def at(self, q: Array) -> Array:
        """Its joints (k,) where the arm's joints (6,) would hold the same flange."""

    def flange(self, joints: Array) -> Transform:
        """X_base_flange at its joints (k,)."""

    def arm_joints(self, joints: Array, near: Array) -> Array:
        """The arm's joints (6,) that hold the flange as its joints (k,) do, nearest to `near`."""

    def along_joints(self, start: Array, q: Array, share: Array) -> Array:
        """Rows (n, k) on the way to the arm's joints (6,); share: (n,) of the way."""

    def along_line(self, start: Array, X_base_flange: Transform, share: Array) -> Array:
        """Rows (n, k) straight in space; share: (n,) of the way."""


class SerialArm:
    """The arm itself: its joints are the arm's joints."""

    def __init__(self, dh: DhParameters) -> None:
        self._dh = dh
        self.links = arm_links(dh)
        self.X_wrist_flange = wrist_flange(dh)

    def at(self, q: Array) -> Array:
        return q

    def flange(self, joints: Array) -> Transform:
        return Transform.from_matrix(forward_batch(self._dh, joints))

    def arm_joints(self, joints: Array, near: Array) -> Array:
        return joints

    def along_joints(self, start: Array, q: Array, share: Array) -> Array:
        rows: Array = start + share[:, None] * (q - start)
        return rows

    def along_line(self, start: Array, X_base_flange: Transform, share: Array) -> Array:
        return follow(self._dh, line(self.flange(start), X_base_flange, share), start)


class Gantry:
    """Rails along x and y, a turn about z, a rail along z: the tool always points down."""

    def __init__(self, dh: DhParameters) -> None:
        self._dh = dh  # of the arm that it stands for
        self.links = gantry_links()
        self.X_wrist_flange = Transform.identity()

    def at(self, q: Array) -> Array:
        return self._joints(forward_batch(self._dh, q), 0.0)

    def flange(self, joints: Array) -> Transform:
        x, y, yaw, down = joints
        turn = Rotation.from_euler("z", yaw) * Rotation.from_euler("x", np.pi)
        return Transform(turn, np.array([x, y, GANTRY_HEIGHT - down]))

    def arm_joints(self, joints: Array, near: Array) -> Array:
        pose = self.flange(joints).as_matrix()
        q: Array = follow(self._dh, pose[None], near, max_step=np.inf)[0]
        return q

    def along_joints(self, start: Array, q: Array, share: Array) -> Array:
        return self._straight(start, forward_batch(self._dh, q), share)

    def along_line(self, start: Array, X_base_flange: Transform, share: Array) -> Array:
        return self._straight(start, X_base_flange.as_matrix(), share)

    def _straight(self, start: Array, X_base_flange: Array, share: Array) -> Array:
        rows: Array = start + share[:, None] * (self._joints(X_base_flange, start[2]) - start)
        return rows

    def _joints(self, X_base_flange: Array, yaw_near: float) -> Array:
        if X_base_flange[2, 2] > -0.9999:
            tilt = np.degrees(np.arccos(np.clip(-X_base_flange[2, 2], -1, 1)))
            raise ArmError(
                f"the gantry holds the tool upright, this pose tilts it by {tilt:.1f} deg: "
                'set simulation.carrier = "arm"'
            )
        x, y, z = X_base_flange[:3, 3]
        yaw = np.arctan2(X_base_flange[1, 0], X_base_flange[0, 0])
        yaw += 2 * np.pi * np.round((yaw_near - yaw) / (2 * np.pi))
        return np.array([x, y, yaw, GANTRY_HEIGHT - z])


def line(X_base_start: Transform, X_base_end: Transform, share: Array) -> Array:
    """Poses (n, 4, 4) on the straight way between two, turning evenly about one axis."""
    turn = (X_base_start.rotation.inv() * X_base_end.rotation).as_rotvec()
    way = X_base_end.translation - X_base_start.translation
    poses = np.zeros((len(share), 4, 4))
    poses[:, :3, :3] = (
        X_base_start.rotation * Rotation.from_rotvec(share[:, None] * turn)
    ).as_matrix()
    poses[:, :3, 3] = X_base_start.translation + share[:, None] * way
    poses[:, 3, 3] = 1.0
    return poses


def follow(
    dh: DhParameters, X_base_flange: Array, start: Array, *, max_step: float = MAX_JOINT_STEP
) -> Array:
    """The arm's joints (n, 6) along poses (n, 4, 4), without a change of branch, from `start`.

    Raises ArmError where the way leaves the arm's reach or a joint would jump.
    """
    if not len(X_base_flange):
        return np.empty((0, 6))
    branches = inverse_batch(dh, X_base_flange)  # (n, 8, 6), nan out of reach
    moved = branches[0] - start
    moved -= 2 * np.pi * np.round(moved / (2 * np.pi))
    farthest = np.abs(moved).max(axis=-1)
    way = branches[:, np.argmin(np.where(np.isnan(farthest), np.inf, farthest))]
    lost = np.isnan(way).any(axis=-1)
    if lost.any():
        x, y, z = X_base_flange[lost.argmax(), :3, 3]
        raise ArmError(
            f"the flange cannot reach ({x:.3f}, {y:.3f}, {z:.3f}) m in base on this way: "
            f"plan a pose within the {dh.name}'s reach"
        )
    rows: Array = np.unwrap(np.concatenate([start[None], way]), axis=0)
    jump = np.abs(np.diff(rows, axis=0)).max(axis=-1)
    if jump.max() > max_step:
        x, y, z = X_base_flange[jump.argmax(), :3, 3]
        raise ArmError(
            f"a joint would jump by {jump.max():.2f} rad near ({x:.3f}, {y:.3f}, {z:.3f}) m in "
            "base, a singularity: choose another way"
        )
    return rows[1:]
