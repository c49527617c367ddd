"""How a UR5 or UR5e stands in its own camera's way: its links as rods, roughly."""

from __future__ import annotations

import numpy as np

from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.kinematics import DhParameters, forward

# UR's description of the UR5: the upper arm runs beside the plane of its joints, the forearm
# nearer to it. Metres along the second joint's axis; a UR5e's differ by a centimetre at most.
UPPER_ARM_OFFSET, FOREARM_OFFSET = 0.13585, 0.13585 - 0.1197
GRIPPER_BODY = 0.6  # of the way from flange to tool; the fingers hold the board beyond
RADII = np.array([0.075, 0.075, 0.065, 0.065, 0.055, 0.05, 0.05, 0.05, 0.05])  # m
SAMPLES = 9  # along each rod
HIDDEN = 0.05  # share of points that may be hidden


def rods(dh: DhParameters, q: Array, X_flange_tool: Transform) -> Array:
    """(9, 2, 3) ends of the links in base, from its foot to the gripper, at joints q (6,) rad."""
    X_base_flange = forward(dh, q, Transform.identity())
    flange, tool = X_base_flange.translation, (X_base_flange @ X_flange_tool).translation
    axis = np.array([np.sin(q[0]), -np.cos(q[0]), 0.0])  # of shoulder, elbow and wrist 1
    ahead, up = np.array([np.cos(q[0]), np.sin(q[0]), 0.0]), np.array([0.0, 0.0, 1.0])
    shoulder = dh.d1 * up
    elbow = shoulder + dh.a2 * (np.cos(q[1]) * ahead + np.sin(q[1]) * up)
    bend = q[1] + q[2]
    wrist1 = elbow + dh.a3 * (np.cos(bend) * ahead + np.sin(bend) * up)
    wrist2 = wrist1 + dh.d4 * axis
    wrist3 = flange - dh.d6 * X_base_flange.rotation.as_matrix()[:, 2]
    out, near = UPPER_ARM_OFFSET * axis, FOREARM_OFFSET * axis
    body = flange + GRIPPER_BODY * (tool - flange)
    corners = [
        (np.zeros(3), shoulder),
        (shoulder, shoulder + out),
        (shoulder + out, elbow + out),
        (elbow + out, elbow + near),
        (elbow + near, wrist1 + near),
        (wrist1 + near, wrist2),
        (wrist2, wrist3),
        (wrist3, flange),
        (flange, body),
    ]
    return np.array(corners, np.float64)


def hides(dh: DhParameters, q: Array, X_flange_tool: Transform, eye: Array, points: Array) -> bool:
    """Whether the arm stands between the eye (3,) and too many of the points (n, 3); all in base,
    metres."""
    ends = rods(dh, q, X_flange_tool)
    share = np.linspace(0, 1, SAMPLES)[:, None, None]
    along = ((1 - share) * ends[:, 0] + share * ends[:, 1]).reshape(-1, 1, 3)
    sight = points - eye
    progress = np.clip(((along - eye) * sight).sum(axis=2) / (sight**2).sum(axis=1), 0.0, 1.0)
    distance = np.linalg.norm(along - (eye + progress[..., None] * sight), axis=2)
    hidden = (distance < np.tile(RADII, SAMPLES)[:, None]).any(axis=0)
    return bool(hidden.mean() > HIDDEN)
