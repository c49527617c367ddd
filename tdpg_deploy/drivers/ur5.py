"""A UR5 or UR5e behind ur_rtde: `hal.Arm` on CB3 (3.4 and newer) and e-series (5.4 and newer).

Motions are asynchronous, and watched from here at the rate of the controller's states: force,
safety, speed slider, program, deadline. ur_rtde itself lives in a child process (ur5_child.py).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tdpg_deploy.cell_config import ArmSection
from tdpg_deploy.drivers.ur5_link import AT_REST, UrLink
from tdpg_deploy.drivers.ur5_status import ControllerVersion, Sample
from tdpg_deploy.errors import ArmError, DeviceError, DeviceTimeout
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import ArmState, Clock, MotionEnd, MotionResult, OnArmState
from tdpg_deploy.kinematics import MODELS, DhParameters, forward, inverse

STOP_DECELERATION = 10.0  # rad/s^2
CONTACT_DECELERATION = 20.0  # rad/s^2: 0.15 m/s at half a metre's reach ends within 2 mm
CONTACT_SAMPLES = 2  # in a row, since a CB3's force, made from currents, spikes
BACK_OFF_SPEED, BACK_OFF_ACCELERATION = 0.02, 0.5  # m/s, m/s^2
ZERO_SAMPLES = 25  # 0.2 s
ON_STATE_EVERY = 3  # samples: 40 Hz
AT_TARGET_JOINTS = 0.005  # rad
AT_TARGET = (0.002, 0.01)  # m, rad
JOINT_RANGE = 2 * np.pi  # rad either way, UR5 and UR5e user manuals
MODEL_TOLERANCE = (0.02, 0.05)  # m, rad: factory calibration moves an arm by a few millimetres
GRIPPER_COG = (0.0, 0.0, 0.058)  # m from the flange, 2F-85 manual, section 6.1


@dataclass(frozen=True, kw_only=True)
class _Target:
    """Where a motion goes: the child's request, whether a state is there, and words for it."""

    request: str
    numbers: tuple[float, ...]
    is_reached: Callable[[ArmState], bool]
    text: str


def _model_at(state: ArmState, X_flange_tool: Transform) -> DhParameters | None:
    """The arm that has its tool there at these joints."""
    for dh in MODELS.values():
        distance, angle = forward(dh, state.q, X_flange_tool).distance(state.X_base_tool)
        if distance < MODEL_TOLERANCE[0] and angle < MODEL_TOLERANCE[1]:
            return dh
    return None


class UrArm:
    """`hal.Arm`. Every failure of a motion is raised with the arm at rest."""

    def __init__(self, config: ArmSection, *, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._X_flange_tool = config.X_flange_tool.transform()
        self._link = UrLink(config.host, clock=clock)
        self._force_zero: Array = np.zeros(3)
        self._stop_asked = threading.Event()
        self._lock = threading.RLock()

    @property
    def version(self) -> ControllerVersion:
        """Of the controller's software. Known after `connect`."""
        return self._link.version

    # --- connection ---------------------------------------------------------------------------

    def connect(self) -> None:
        """Check the controller, then start the driver's program on it. Nothing moves.

        Raises what stands in the way: DeviceUnreachable, DeviceTimeout, ProtectiveStop,
        EmergencyStop, ArmError.
        """
        self._link.open()
        try:
            tcp = tuple(map(float, self._X_flange_tool.as_rotation_vector()))
            self._link.set_up(tcp, self._config.payload, GRIPPER_COG)
            self._check_model()
        except DeviceError:
            self._link.close()
            raise

    def close(self) -> None:
        """Stop the arm and let it go. May be called twice."""
        self.stop()
        self._link.close()

    def recover(self, *, deadline: float = 30.0) -> None:
        """Make the arm ready again, once a person has looked at it. Nothing moves.

        Releases a protective stop, which the controller allows five seconds after it began,
        drops the interrupted motion for good and starts the driver's program anew.
        Raises what still stands in the way.
        """
        self._link.unlock(deadline=deadline)
        self.connect()

    def _check_model(self) -> None:
        asked, state = self._config.dh, self.state()
        found = _model_at(state, self._X_flange_tool)
        if found is None:
            raise ArmError(
                f"the controller has its tool at {np.round(state.X_base_tool.translation, 3)} m, "
                f"where neither a {' nor a '.join(dh.name for dh in MODELS.values())} has it: this "
                "driver knows no other arm"
            )
        if found != asked:
            raise ArmError(
                f"the arm is a {found.name}, and the cell file is one for a {asked.name}: set "
                f'arm.model = "{found.name.lower()}", and see that arm.home suits it'
            )

    # --- state --------------------------------------------------------------------------------

    def state(self) -> ArmState:
        with self._lock:
            self._link.sample()  # may have been under way when the call began
            return self._as_state(self._link.sample())

    def zero_force(self) -> None:
        with self._lock:
            if np.abs(self.state().qd).max() > AT_REST:
                raise ArmError("the force cannot be zeroed in motion: wait until the arm rests")
            forces = [self._link.sample().force for _ in range(ZERO_SAMPLES)]
        self._force_zero = np.mean(forces, axis=0)

    def _as_state(self, sample: Sample) -> ArmState:
        return ArmState(
            q=np.array(sample.q),
            qd=np.array(sample.qd),
            X_base_tool=Transform.from_rotation_vector(sample.pose),
            force=np.array(sample.force) - self._force_zero,
            stamp=sample.stamp,
        )

    # --- motion -------------------------------------------------------------------------------

    def move_joints(
        self,
        q: Array,
        *,
        speed: float,
        acceleration: float,
        deadline: float,
        on_state: OnArmState | None = None,
    ) -> MotionResult:
        if not (np.isfinite(q).all() and np.abs(q).max() <= JOINT_RANGE):
            raise ArmError(
                f"joints {np.round(q, 2).tolist()} rad lie outside of the arm's range of "
                f"{JOINT_RANGE:.2f} rad either way: nothing was moved"
            )
        target = _Target(
            request="move_joints",
            numbers=tuple(map(float, q)),
            is_reached=lambda state: bool(np.abs(state.q - q).max() < AT_TARGET_JOINTS),
            text=f"joints {np.round(np.degrees(q), 1).tolist()} degrees",
        )
        return self._move(target, speed, acceleration, deadline, None, on_state)

    def move_linear(
        self,
        X_base_tool: Transform,
        *,
        speed: float,
        acceleration: float,
        deadline: float,
        stop_force: float | None = None,
        on_state: OnArmState | None = None,
    ) -> MotionResult:
        if not len(inverse(self._config.dh, X_base_tool, self._X_flange_tool)):
            raise ArmError(  # the controller would end the driver's program
                f"the arm cannot reach tool pose {np.round(X_base_tool.translation, 3).tolist()} m:"
                " nothing was moved"
            )

        def is_reached(state: ArmState) -> bool:
            distance, angle = state.X_base_tool.distance(X_base_tool)
            return distance < AT_TARGET[0] and angle < AT_TARGET[1]

        target = _Target(
            request="move_linear",
            numbers=tuple(map(float, X_base_tool.as_rotation_vector())),
            is_reached=is_reached,
            text=f"tool at {np.round(X_base_tool.translation, 3).tolist()} m",
        )
        return self._move(target, speed, acceleration, deadline, stop_force, on_state)

    def stop(self) -> None:
        self._stop_asked.set()  # a motion in another thread ends itself, and lets go of the lock
        with self._lock:
            if self._link.is_open:
                self._link.halt(STOP_DECELERATION)

    def _move(
        self,
        target: _Target,
        speed: float,
        acceleration: float,
        deadline: float,
        stop_force: float | None,
        on_state: OnArmState | None,
    ) -> MotionResult:
        with self._lock:
            self._link.require_open()  # else there is nothing to halt, but others' programs
            self._stop_asked.clear()
            end = self._clock.now() + deadline
            try:
                before = self._link.start(target.request, target.numbers, speed, acceleration)
                clear = self._watch(target.text, before, end, stop_force, on_state)
                if clear is not None:
                    rest = self._back_off(clear, stop_force, end)
                    return MotionResult(end=MotionEnd.CONTACT, state=self._as_state(rest))
                state = self._as_state(self._link.at_rest(until=end))
            except BaseException:
                self._link.halt(STOP_DECELERATION)
                raise
            if not target.is_reached(state):
                raise self._link.cause(f"at the end of a motion that fell short of {target.text}")
            return MotionResult(end=MotionEnd.REACHED, state=state)

    def _back_off(self, clear: Sample, stop_force: float | None, end: float) -> Sample:
        """Come to rest. Where the way to stop led on into what was touched, go back out of it:
        the force would end the next motion, too."""
        rest = self._link.brake(CONTACT_DECELERATION)
        if stop_force is None or np.linalg.norm(self._as_state(rest).force) <= stop_force:
            return rest
        before = self._link.start("move_linear", clear.pose, BACK_OFF_SPEED, BACK_OFF_ACCELERATION)
        self._watch("where the contact began", before, end, None, None)
        return self._link.at_rest(until=end)

    def _watch(
        self,
        text: str,
        before: int,
        end: float,
        stop_force: float | None,
        on_state: OnArmState | None,
    ) -> Sample | None:
        """Until the motion that follows operation `before` is over; after a contact, the last
        sample without it."""
        count = pressed = 0
        clear: Sample | None = None
        while True:
            sample = self._link.watch(f"the motion to {text}")
            state = self._as_state(sample)
            if stop_force is None or np.linalg.norm(state.force) <= stop_force:
                clear, pressed = sample, 0
            else:
                pressed += 1
                if pressed == CONTACT_SAMPLES:
                    return clear or sample
            if on_state is not None and count % ON_STATE_EVERY == 0:
                on_state(state)
            if self._stop_asked.is_set():
                raise ArmError(f"the motion to {text} was stopped on request")
            if sample.operation != before and not sample.running:
                return None
            if self._clock.now() > end:
                raise DeviceTimeout(
                    f"the motion to {text} was not over in time, with the speed slider at "
                    f"{sample.slider:.0%}; the arm was stopped"
                )
            count += 1
