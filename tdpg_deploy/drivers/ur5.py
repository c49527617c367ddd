"""A UR5 behind ur_rtde: `hal.Arm` on CB3 (3.4 and newer) and e-series (5.4 and newer).

Motions are asynchronous, and watched from here at the rate of the controller's states: force,
safety, speed slider, program, deadline. ur_rtde itself lives in a child process (ur5_child.py).
Whatever goes wrong, the program on the controller is stopped, so that nobody who presses
"play" resumes a motion that was reported as failed. Only `recover` starts it again.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tdpg_deploy import kinematics
from tdpg_deploy.cell_config import ArmSection
from tdpg_deploy.drivers import ur5_network
from tdpg_deploy.drivers.ur5_control import ControlProcess
from tdpg_deploy.drivers.ur5_status import (
    ControllerVersion,
    ProgramStopped,
    SafetyMode,
    Sample,
    motion_problem,
    safety_problem,
)
from tdpg_deploy.errors import ArmError, DeviceError, DeviceTimeout, DeviceUnreachable
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import ArmState, Clock, MotionEnd, MotionResult, OnArmState

WATCHDOG = 4.0  # Hz: a quarter of a second without word from here stops the program
START_DEADLINE = 15.0  # s for ur_rtde to connect, upload and start its program
STOP_DEADLINE = 2.0  # s to come to rest
STOP_DECELERATION = 10.0  # rad/s^2
CONTACT_DECELERATION = 20.0  # rad/s^2: 0.15 m/s at half a metre's reach ends within 2 mm
ON_STATE_EVERY = 4  # samples: 31 Hz
CONTACT_SAMPLES = 2  # in a row, since a CB3's force, made from currents, spikes
ZERO_SAMPLES = 25  # 0.2 s
CAUSE_SAMPLES = 12  # 0.1 s: the safety mode may follow the end of the program by so much
AT_REST = 0.01  # rad/s
AT_TARGET_JOINTS = 0.005  # rad
AT_TARGET = (0.002, 0.01)  # m, rad
MODEL_TOLERANCE = (0.02, 0.05)  # m, rad: factory calibration moves a UR5 by a few millimetres
GRIPPER_COG = (0.0, 0.0, 0.058)  # m from the flange, 2F-85 manual, section 6.1


@dataclass(frozen=True, kw_only=True)
class _Target:
    """Where a motion goes: the child's request, whether a state is there, and words for it."""

    request: str
    numbers: tuple[float, ...]
    is_reached: Callable[[ArmState], bool]
    text: str


class UrArm:
    """`hal.Arm`. Every failure of a motion is raised with the arm at rest."""

    def __init__(self, config: ArmSection, *, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._X_flange_tool = config.X_flange_tool.transform()
        self._control = ControlProcess(config.host)
        self._version: ControllerVersion | None = None
        self._force_zero = np.zeros(3)
        self._sampled_at = clock.now()
        self._longest_gap = 0.0
        self._stop_asked = threading.Event()
        self._motion_lock = threading.RLock()

    @property
    def version(self) -> ControllerVersion:
        """Of the controller's software. Known after `connect`."""
        if self._version is None:
            raise DeviceUnreachable("the arm is not connected: call connect()")
        return self._version

    # --- connection ---------------------------------------------------------------------------

    def connect(self) -> None:
        """Check the controller, then start the driver's program on it. Nothing moves.

        Raises what stands in the way: DeviceUnreachable, DeviceTimeout, ProtectiveStop,
        EmergencyStop, ArmError.
        """
        self._check_controller()
        try:
            self._control.start(deadline=START_DEADLINE)
        except ArmError as error:
            raise self._start_problem(str(error)) from error
        try:
            self._set_up()
        except DeviceError:
            self._control.kill()
            raise

    def close(self) -> None:
        """Stop the arm and let it go. May be called twice."""
        if self._control.is_alive:
            self.stop()
            self._stop_program()
        self._control.kill()

    def recover(self, *, deadline: float = 30.0) -> None:
        """Make the arm ready again, once a person has looked at it. Nothing moves.

        Releases a protective stop, which the controller allows five seconds after it began,
        drops the interrupted program for good and starts the driver's anew.
        Raises what still stands in the way.
        """
        self._control.kill()
        end = self._clock.now() + deadline
        host = self._config.host
        self._check_version()
        _, safety_mode = ur5_network.ask_modes(host)
        if safety_mode == SafetyMode.PROTECTIVE_STOP:
            command = ("close safety popup", "unlock protective stop")
            while "releasing" not in (reply := ur5_network.ask_dashboard(host, *command)[1]):
                if self._clock.now() > end:
                    raise DeviceTimeout(
                        f"the protective stop was not released within {deadline:.0f} s; the "
                        f"controller says: {reply}"
                    )
                self._clock.sleep(0.25)
        ur5_network.ask_dashboard(host, "stop")
        self.connect()

    def _check_controller(self) -> None:
        """Find by questions what would make ur_rtde hang or fail without a reason."""
        self._check_version()
        host = self._config.host
        if problem := safety_problem(*ur5_network.ask_modes(host)):
            raise problem
        ur5_network.check_script_port(host)

    def _check_version(self) -> None:
        """Of the software, and of what it lets this driver do."""
        host = self._config.host
        self._version = ur5_network.ask_version(host)
        if not self._version.is_supported:
            raise ArmError(
                f"the controller at {host} runs PolyScope {self._version}; this driver needs 3.4 "
                "or newer (CB3) or 5.4 or newer (e-series): update it"
            )
        if self._version.has_remote_control and not ur5_network.ask_remote_control(host):
            raise _local_control()

    def _start_problem(self, text: str) -> ArmError:
        if "already in use" in text:
            return ArmError(
                "the controller's input registers are in use: end the other program that "
                "controls this arm, or disable EtherNet/IP, PROFINET and MODBUS in the "
                f"installation ({text})"
            )
        return ArmError(f"the driver's program did not start on the controller: {text}")

    def _set_up(self) -> None:
        tcp = tuple(self._X_flange_tool.as_rotation_vector())
        if not self._control.call("set_up", tcp, self._config.payload, GRIPPER_COG, WATCHDOG):
            raise self._cause("TCP, payload and watchdog were not accepted")
        state = self.state()
        expected = kinematics.forward(state.q, self._X_flange_tool)
        distance, angle = expected.distance(state.X_base_tool)
        if distance > MODEL_TOLERANCE[0] or angle > MODEL_TOLERANCE[1]:
            raise ArmError(
                f"the controller sees its tool {distance * 1000:.0f} mm and {angle:.2f} rad from "
                f"where a {self._config.model} has it: check arm.model and arm.X_flange_tool"
            )

    # --- state --------------------------------------------------------------------------------

    def state(self) -> ArmState:
        self._sample()  # may have been under way when the call began
        return self._as_state(self._sample())

    def zero_force(self) -> None:
        first = self.state()
        if np.abs(first.qd).max() > AT_REST:
            raise ArmError("the force cannot be zeroed while the arm moves: wait until it rests")
        forces = [self._sample().force for _ in range(ZERO_SAMPLES)]
        self._force_zero = np.mean(forces, axis=0)

    def _sample(self) -> Sample:
        """The next state. Raises DeviceError when none comes; the connection is over then."""
        sample: Sample | None = self._control.call("sample")
        if sample is None:
            self._control.kill()
            raise DeviceUnreachable(
                f"no state came from the arm at {self._config.host} for 0.3 s, the connection is "
                "given up: check cable and controller, then call recover()"
            )
        now = self._clock.now()
        self._longest_gap = max(self._longest_gap, now - self._sampled_at)
        self._sampled_at = now
        return sample

    def _as_state(self, sample: Sample) -> ArmState:
        return ArmState(
            q=np.array(sample.q),
            qd=np.array(sample.qd),
            X_base_tool=Transform.from_rotation_vector(sample.pose),
            force=np.array(sample.force) - self._force_zero,
            stamp=self._clock.now(),
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
        with self._motion_lock:
            if self._control.is_alive:
                self._halt()

    def _move(
        self,
        target: _Target,
        speed: float,
        acceleration: float,
        deadline: float,
        stop_force: float | None,
        on_state: OnArmState | None,
    ) -> MotionResult:
        with self._motion_lock:
            self._stop_asked.clear()
            end = self._clock.now() + deadline
            before = self._sample()
            self._longest_gap = 0.0
            if motion_problem(before):
                raise self._cause(f"before the motion to {target.text}")
            try:
                if not self._control.call(target.request, target.numbers, speed, acceleration):
                    raise self._cause(f"at the start of the motion to {target.text}")
                touched = self._watch(target, before.operation, end, stop_force, on_state)
                state = self._come_to_rest(CONTACT_DECELERATION) if touched else self._settle(end)
            except BaseException:
                self._halt()
                raise
        if not touched and not target.is_reached(state):
            raise self._cause(f"the motion to {target.text} ended short of it")
        return MotionResult(end=MotionEnd.CONTACT if touched else MotionEnd.REACHED, state=state)

    def _watch(
        self,
        target: _Target,
        before: int,
        end: float,
        stop_force: float | None,
        on_state: OnArmState | None,
    ) -> bool:
        """Until the motion that follows operation `before` is over; True after a contact."""
        count = pressed = 0
        while True:
            sample = self._sample()
            if motion_problem(sample):
                raise self._cause(f"during the motion to {target.text}")
            state = self._as_state(sample)
            if stop_force is not None:
                pressed = pressed + 1 if np.linalg.norm(state.force) > stop_force else 0
                if pressed == CONTACT_SAMPLES:
                    return True
            if on_state is not None and count % ON_STATE_EVERY == 0:
                on_state(state)
            if sample.operation != before and not sample.running:
                return False
            if self._stop_asked.is_set():
                raise ArmError(f"the motion to {target.text} was stopped on request")
            if self._clock.now() > end:
                raise DeviceTimeout(
                    f"the motion to {target.text} was not over in time, with the speed slider at "
                    f"{sample.slider:.0%}; the arm was stopped"
                )
            count += 1

    def _settle(self, end: float) -> ArmState:
        """The state at rest after a motion that is over."""
        while np.abs((state := self.state()).qd).max() > AT_REST:
            if self._clock.now() > end:
                raise DeviceTimeout("the arm did not come to rest in time and was stopped")
        return state

    def _come_to_rest(self, deceleration: float) -> ArmState:
        """Decelerate (rad/s^2), and the state at rest."""
        self._control.call("stop", deceleration, deadline=STOP_DEADLINE)
        return self._settle(self._clock.now() + STOP_DEADLINE)

    def _halt(self) -> None:
        """Bring the arm to rest; if it does not obey, by the end of its program.

        When the controller hears nothing at all any more, its watchdog ends the program.
        """
        try:
            self._come_to_rest(STOP_DECELERATION)
        except DeviceError:
            self._control.kill()
            self._stop_program()

    def _stop_program(self) -> None:
        with contextlib.suppress(DeviceError):
            ur5_network.ask_dashboard(self._config.host, "stop", deadline=1.0)

    def _cause(self, when: str) -> ArmError:
        """Why the arm does not move, as a typed error; the program is stopped for good.

        States that come within a tenth of a second may name it better than the first.
        """
        for _ in range(CAUSE_SAMPLES):
            sample = self._sample()
            problem = motion_problem(sample)
            if problem is not None and not isinstance(problem, ProgramStopped):
                break
        where = (
            f"{when}; tool at {np.round(sample.pose[:3], 3).tolist()} m, "
            f"force {np.linalg.norm(np.array(sample.force) - self._force_zero):.0f} N"
        )
        if problem is None:
            return ArmError(f"{where}: no cause is reported; look at the arm and its log")
        self._stop_program()
        if isinstance(problem, ProgramStopped):
            problem = self._why_stopped() or problem
        return type(problem)(f"{problem} ({where})")

    def _why_stopped(self) -> ArmError | None:
        """What stops a program besides a person: local control, and the watchdog."""
        with contextlib.suppress(DeviceError):
            if self.version.has_remote_control and not ur5_network.ask_remote_control(
                self._config.host
            ):
                return _local_control()
        if self._longest_gap > 1 / WATCHDOG:
            return ArmError(
                f"the controller's watchdog stopped the arm: this process did not look at it for "
                f"{self._longest_gap:.2f} s ({1 / WATCHDOG:.2f} s are allowed): let `on_state` do "
                "less, or give the process more of the machine; then call recover()"
            )
        return None


def _local_control() -> ArmError:
    return ArmError(
        "remote control is off: switch the controller to remote control at the upper right of "
        "the pendant, then call recover()"
    )
