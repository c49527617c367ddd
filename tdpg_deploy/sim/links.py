"""The robot as a tree of links: a UR arm, the gantry that replaces it for training, the 2F-85.

Data only; `robot.py` makes a multibody of it. The frame of a link is at its joint.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.kinematics import UR5, UR5E, DhParameters
from tdpg_deploy.sim.bodies import box, cylinder
from tdpg_deploy.sim.pieces import ConvexPiece

UR_GREY = (176, 182, 190)
UR_BLUE = (96, 142, 178)
GRIPPER_BLACK = (52, 54, 58)
PAD_GREY = (88, 90, 92)


class Joint(Enum):
    FIXED = "fixed"
    SLIDES = "slides"
    TURNS = "turns"


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """parent: index of another link, -1 for the base. X_parent_link: pose while the joint is at
    zero. axis: of the joint, in the link's frame. mass: kg. force: N or N m of its motor."""

    name: str
    parent: int
    joint: Joint
    mass: float
    X_parent_link: Transform = field(default_factory=Transform.identity)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    force: float = 0.0
    pieces: tuple[ConvexPiece, ...] = ()
    rgb: tuple[int, int, int] = UR_GREY


# --- UR arms ----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Build:
    """masses: kg of each link. upper_arm, forearm: m by which they run beside the plane of their
    joints, along those joints' axes."""

    masses: tuple[float, float, float, float, float, float]
    upper_arm: float
    forearm: float


# Masses from the source of the DH parameters; offsets from ros-industrial's ur_description.
_BUILDS = {
    UR5: _Build(masses=(3.7, 8.393, 2.275, 1.219, 1.219, 0.1879), upper_arm=0.136, forearm=0.016),
    UR5E: _Build(masses=(3.761, 8.058, 2.846, 1.37, 1.3, 0.365), upper_arm=0.138, forearm=0.007),
}
_TORQUES = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)  # N m, same source


def _beyond_joint(dh: DhParameters, i: int) -> Transform:
    """Joint i + 1 as joint i carries it: the Denavit-Hartenberg step after the turn about z."""
    d, a, alpha = dh.joints[i]
    return Transform(Rotation.from_euler("x", alpha), np.array([a, 0.0, d]))


def wrist_flange(dh: DhParameters) -> Transform:
    """X_wrist3_flange."""
    return _beyond_joint(dh, 5)


def _along_x(radius: float, start: float, end: float, z: float) -> Array:
    """A cylinder between two x, its axis at height z."""
    return cylinder(radius, start, end)[:, [2, 1, 0]] + (0, 0, z)


def _limbs(dh: DhParameters) -> tuple[tuple[ConvexPiece, ...], ...]:
    """Round limbs of about the arm's thickness, each in the frame of its joint."""
    upper_arm, forearm = _BUILDS[dh].upper_arm, _BUILDS[dh].forearm
    beside = upper_arm + 0.054  # outer side of the joint housings
    hulls = (
        [cylinder(0.060, 0.020, dh.d1 + 0.061)],
        [cylinder(0.058, 0.055, beside), _along_x(0.054, dh.a2, 0.0, upper_arm)],
        [cylinder(0.056, forearm - 0.061, beside), _along_x(0.043, dh.a3, 0.0, forearm)],
        [cylinder(0.042, forearm - 0.046, dh.d4 + 0.046)],
        [cylinder(0.042, -0.050, dh.d5 + 0.045)],
        [cylinder(0.040, -0.045, dh.d6)],
    )
    return tuple(tuple(ConvexPiece.from_vertices(hull) for hull in link) for link in hulls)


@cache
def arm_links(dh: DhParameters) -> tuple[Link, ...]:
    """Six turning links, parent before child, in UR's `base` frame."""
    before = (Transform.identity(), *(_beyond_joint(dh, i) for i in range(5)))
    names = ("shoulder", "upper arm", "forearm", "wrist 1", "wrist 2", "wrist 3")
    return tuple(
        Link(
            name=name,
            parent=index - 1,
            joint=Joint.TURNS,
            mass=_BUILDS[dh].masses[index],
            X_parent_link=before[index],
            force=_TORQUES[index],
            pieces=pieces,
            rgb=UR_BLUE if index % 2 else UR_GREY,
        )
        for index, (name, pieces) in enumerate(zip(names, _limbs(dh), strict=True))
    )


# --- gantry -----------------------------------------------------------------------------------

GANTRY_HEIGHT = 1.0  # m; lower rails' bounding boxes would keep piles of objects awake


@cache
def gantry_links() -> tuple[Link, ...]:
    """x, y, yaw, then z downwards; the last link's frame is the flange."""
    return (
        Link(
            name="x rail",
            parent=-1,
            joint=Joint.SLIDES,
            axis=(1.0, 0.0, 0.0),
            mass=1.0,
            force=300.0,
            X_parent_link=Transform(Rotation.identity(), np.array([0.0, 0.0, GANTRY_HEIGHT])),
        ),
        Link(
            name="y rail",
            parent=0,
            joint=Joint.SLIDES,
            axis=(0.0, 1.0, 0.0),
            mass=1.0,
            force=300.0,
        ),
        Link(name="yaw", parent=1, joint=Joint.TURNS, mass=1.0, force=100.0),
        Link(
            name="z rail",
            parent=2,
            joint=Joint.SLIDES,
            mass=0.5,
            force=300.0,
            X_parent_link=Transform(Rotation.from_euler("x", np.pi), np.zeros(3)),
        ),
    )


# --- 2F-85 ------------------------------------------------------------------------------------

MAX_WIDTH = 0.085  # m, 2F-85 instruction manual, "stroke"
TIP_CLOSED = 0.163  # m from the flange to the tips; with open fingers 14 mm less
_KNUCKLE = 0.0573  # m, the bar on which a finger tip swings
_SINE_CLOSED = -0.085  # of the knuckle's angle from the approach axis when closed


def tip_retreat(width: float) -> float:
    """Metres that the tips stand behind their closed place, from the linkage's arc."""
    sine = _SINE_CLOSED + width / 2 / _KNUCKLE
    return float(_KNUCKLE * (np.sqrt(1 - _SINE_CLOSED**2) - np.sqrt(1 - sine * sine)))


@cache
def _gripper_pieces() -> tuple[tuple[ConvexPiece, ...], tuple[ConvexPiece, ...]]:
    """Of the palm, from the flange on; of a finger, its pad's face at x = 0, its tip at z = 0."""
    palm = cylinder(0.0375, 0.0, 0.045), box(0.100, 0.062, 0.055, center=(0, 0, 0.068))
    pad = box(0.014, 0.022, 0.0375, center=(0.007, 0, -0.01875))
    bar = box(0.024, 0.026, 0.048, center=(0.018, 0, -0.0615))
    return (
        tuple(ConvexPiece.from_vertices(hull) for hull in palm),
        tuple(ConvexPiece.from_vertices(hull) for hull in (pad, bar)),
    )


def gripper_links(wrist: int, X_wrist_flange: Transform) -> tuple[Link, ...]:
    """Palm, arc, left finger (towards tool +x), right finger; carried by the link `wrist`.

    The arc slides both fingers along the approach axis as the linkage would; each finger
    slides by half the width.
    """
    palm, finger = _gripper_pieces()
    mirror = Transform(Rotation.from_euler("z", np.pi), np.zeros(3))
    tip = Transform(Rotation.identity(), np.array([0.0, 0.0, TIP_CLOSED]))
    return (
        Link(
            name="palm",
            parent=wrist,
            joint=Joint.FIXED,
            mass=0.6,
            X_parent_link=X_wrist_flange,
            pieces=palm,
            rgb=GRIPPER_BLACK,
        ),
        Link(
            name="arc",
            parent=wrist + 1,
            joint=Joint.SLIDES,
            axis=(0.0, 0.0, -1.0),
            mass=0.05,
            force=600.0,  # the arm gives way first
        ),
        *(
            Link(
                name=name,
                parent=wrist + 2,
                joint=Joint.SLIDES,
                axis=(1.0, 0.0, 0.0),
                mass=0.1,
                X_parent_link=X_arc_finger,
                pieces=finger,
                rgb=PAD_GREY,
            )
            for name, X_arc_finger in (("left finger", tip), ("right finger", tip @ mirror))
        ),
    )
