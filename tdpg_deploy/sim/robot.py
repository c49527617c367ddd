"""The robot's body in the physics: carrier and gripper as one multibody with motors.

Everything here is measured from, or commanded to, joints and contacts. Nothing is attached
to an object and no object is moved by hand: what is held is held by friction.
"""

from __future__ import annotations

import numpy as np
import pybullet

from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.sim.carriers import Carrier
from tdpg_deploy.sim.links import Joint, gripper_links, tip_retreat
from tdpg_deploy.sim.physics import PAD_FRICTION, PAD_TORSION, collision_shape
from tdpg_deploy.sim.pieces import ROBOT, VisiblePiece

_JOINT_TYPES = {
    Joint.FIXED: pybullet.JOINT_FIXED,
    Joint.SLIDES: pybullet.JOINT_PRISMATIC,
    Joint.TURNS: pybullet.JOINT_REVOLUTE,
}
_GEAR_FORCE = 200.0  # N; without the gear between them the fingers drift by 5 mm


class Robot:
    def __init__(self, client: int, carrier: Carrier, q_home: Array, width: float) -> None:
        self._client = client
        self.carrier = carrier
        self._links = carrier.links + gripper_links(len(carrier.links) - 1, carrier.X_wrist_flange)
        self._joints = [i for i, link in enumerate(carrier.links) if link.joint is not Joint.FIXED]
        self._forces = [carrier.links[i].force for i in self._joints]
        palm = len(carrier.links)
        self._arc, self._left, self._right = palm + 1, palm + 2, palm + 3
        self._arc_force = self._links[self._arc].force
        self.body = self._build()
        self.place(carrier.at(q_home), width)

    # --- carrier ------------------------------------------------------------------------------

    def joints(self) -> tuple[Array, Array]:
        """Positions and speeds of the carrier's joints, (k,) each."""
        states = pybullet.getJointStates(self.body, self._joints, physicsClientId=self._client)
        return np.array([state[0] for state in states]), np.array([state[1] for state in states])

    def drive(self, joints: list[float]) -> None:
        """Be at these positions (k,) after the next step, as far as the motors' forces go."""
        pybullet.setJointMotorControlArray(
            self.body,
            self._joints,
            pybullet.POSITION_CONTROL,
            targetPositions=joints,
            forces=self._forces,
            positionGains=[1.0] * len(joints),
            velocityGains=[1.0] * len(joints),
            physicsClientId=self._client,
        )

    def hold(self) -> None:
        """Stay where the carrier is."""
        self.drive(self.joints()[0].tolist())

    def force(self) -> Array:
        """(3,) N in base: what the world presses on the robot, by the last step's contacts."""
        total = np.zeros(3)
        for contact in pybullet.getContactPoints(self.body, physicsClientId=self._client):
            total += np.multiply(contact[7], contact[9])
            total += np.multiply(contact[11], contact[10])
            total += np.multiply(contact[13], contact[12])
        return total

    # --- fingers ------------------------------------------------------------------------------

    def width(self) -> float:
        """Metres between the pads."""
        left, right = pybullet.getJointStates(
            self.body, [self._left, self._right], physicsClientId=self._client
        )
        return float(left[0] + right[0])

    def width_speed(self) -> float:
        """m/s, above zero while opening."""
        left, right = pybullet.getJointStates(
            self.body, [self._left, self._right], physicsClientId=self._client
        )
        return float(left[1] + right[1])

    def drive_fingers(self, width: float, force: float) -> None:
        """Go for this width (m) with at most this force (N) on each pad; call every step while
        the fingers move, for the arc follows the width that they have reached.

        One motor bends the linkage: tips that come down on something stall, they do not lift
        the arm.
        """
        self._drive_fingers(width, force, tip_retreat(self.width()), 2 * force)

    def hold_fingers(self, width: float, force: float) -> None:
        """Keep going for this width, the linkage locked as it stands."""
        arc = pybullet.getJointState(self.body, self._arc, physicsClientId=self._client)[0]
        self._drive_fingers(width, force, arc, self._arc_force)

    def _drive_fingers(self, width: float, force: float, arc: float, arc_force: float) -> None:
        pybullet.setJointMotorControlArray(
            self.body,
            [self._left, self._right, self._arc],
            pybullet.POSITION_CONTROL,
            targetPositions=[width / 2, width / 2, arc],
            forces=[force, force, arc_force],
            positionGains=[0.5, 0.5, 0.5],
            velocityGains=[1.0, 1.0, 1.0],
            physicsClientId=self._client,
        )

    # --- body ---------------------------------------------------------------------------------

    def place(self, joints: Array, width: float) -> None:
        """Put the robot here, at rest. For building a scene only."""
        fingers = {self._left: width / 2, self._right: width / 2, self._arc: tip_retreat(width)}
        positions = dict(zip(self._joints, joints.tolist(), strict=True)) | fingers
        for index, position in positions.items():
            pybullet.resetJointState(self.body, index, position, physicsClientId=self._client)
        self.drive(joints.tolist())
        self.hold_fingers(width, 20.0)

    def visible(self) -> list[VisiblePiece]:
        pieces = []
        states = pybullet.getLinkStates(
            self.body,
            list(range(len(self._links))),
            computeForwardKinematics=True,
            physicsClientId=self._client,
        )
        for link, state in zip(self._links, states, strict=True):
            X_base_link = Transform.from_quaternion(state[4], state[5])
            pieces += [VisiblePiece(piece, X_base_link, link.rgb, ROBOT) for piece in link.pieces]
        return pieces

    def _build(self) -> int:
        links, client = self._links, self._client
        count = len(links)
        body: int = pybullet.createMultiBody(
            baseMass=0,
            linkMasses=[link.mass for link in links],
            linkCollisionShapeIndices=[collision_shape(client, link.pieces) for link in links],
            linkVisualShapeIndices=[-1] * count,
            linkPositions=[link.X_parent_link.translation.tolist() for link in links],
            linkOrientations=[link.X_parent_link.rotation.as_quat().tolist() for link in links],
            linkInertialFramePositions=[(0, 0, 0)] * count,
            linkInertialFrameOrientations=[(0, 0, 0, 1)] * count,
            linkParentIndices=[link.parent + 1 for link in links],  # pybullet's base is 0
            linkJointTypes=[_JOINT_TYPES[link.joint] for link in links],
            linkJointAxis=[link.axis for link in links],
            physicsClientId=client,
        )
        for index in range(-1, count):
            pybullet.changeDynamics(
                body,
                index,
                lateralFriction=PAD_FRICTION if index in (self._left, self._right) else 0.5,
                spinningFriction=PAD_TORSION if index in (self._left, self._right) else 0.0,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                restitution=0.0,
                physicsClientId=client,
            )
        gear = pybullet.createConstraint(
            body,
            self._left,
            body,
            self._right,
            pybullet.JOINT_GEAR,
            jointAxis=(1, 0, 0),
            parentFramePosition=(0, 0, 0),
            childFramePosition=(0, 0, 0),
            physicsClientId=client,
        )
        pybullet.changeConstraint(
            gear, gearRatio=-1, maxForce=_GEAR_FORCE, erp=0.2, physicsClientId=client
        )
        return body
