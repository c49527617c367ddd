"""The way to a UR controller: opened after questions, watched, named when it fails, cut at need.

Whatever goes wrong, the program on the controller is stopped, so that nobody who presses
"play" resumes a motion that was reported as failed. Only `recover` starts it again.
"""

from __future__ import annotations

import contextlib
from collections import deque
from dataclasses import replace
from itertools import pairwise

import numpy as np

from tdpg_deploy.drivers import ur5_network
from tdpg_deploy.drivers.ur5_control import ControlProcess
from tdpg_deploy.drivers.ur5_stamps import Stamps
from tdpg_deploy.drivers.ur5_status import (
    ControllerVersion,
    ProgramStopped,
    SafetyMode,
    Sample,
    motion_problem,
    safety_problem,
)
from tdpg_deploy.errors import ArmError, DeviceError, DeviceTimeout, DeviceUnreachable
from tdpg_deploy.hal import Clock

WATCHDOG = 2.0  # Hz: half a second without word from here stops the program
START_DEADLINE = 15.0  # s for ur_rtde to connect, upload and start its program
STOP_DEADLINE = 2.0  # s for the arm to come to rest
CAUSE_SAMPLES = 12  # 0.1 s: the safety mode may follow the end of the program by so much
AT_REST = 0.01  # rad/s


class UrLink:
    """Calls are bounded and raise DeviceError. Use from one thread at a time."""

    def __init__(self, host: str, *, clock: Clock) -> None:
        self._host = host
        self._clock = clock
        self._control = ControlProcess(host)
        self._version: ControllerVersion | None = None
        self._stamps = Stamps()
        self._looks: deque[float] = deque(maxlen=3)  # when states were asked for, latest last

    @property
    def is_open(self) -> bool:
        return self._control.is_alive

    @property
    def version(self) -> ControllerVersion:
        if self._version is None:
            raise DeviceUnreachable("the arm is not connected: call connect()")
        return self._version

    # --- open and close -----------------------------------------------------------------------

    def open(self) -> None:
        """Find by questions what would make ur_rtde hang or fail without a reason; start it."""
        self._check_version()
        if problem := safety_problem(*ur5_network.ask_modes(self._host)):
            raise problem
        ur5_network.check_script_port(self._host)
        self._stamps = Stamps()
        try:
            self._control.start(deadline=START_DEADLINE)
        except ArmError as error:
            raise _start_problem(str(error)) from error

    def _check_version(self) -> None:
        """Of the software, and whether it is to be controlled from here."""
        self._version = ur5_network.ask_version(self._host)
        if not self._version.is_supported:
            raise ArmError(
                f"the controller at {self._host} runs PolyScope {self._version}; this driver needs "
                "3.4 or newer (CB3) or 5.4 or newer (e-series): update it"
            )
        if self._is_local():
            raise _local_control()

    def set_up(self, tcp: tuple[float, ...], mass: float, cog: tuple[float, ...]) -> None:
        """TCP (UR pose, m, rad), payload (kg) and its centre (m), and the watchdog."""
        if not self._control.call("set_up", tcp, mass, cog, WATCHDOG):
            raise self.cause("TCP, payload and watchdog were not accepted")

    def close(self) -> None:
        """End ur_rtde, and what it runs on the controller."""
        if self._control.is_alive:
            self.stop_program()
        self._control.kill()

    def unlock(self, *, deadline: float) -> None:
        """Release a protective stop, and forget the program that it interrupted.

        The controller refuses within five seconds of the stop; it is asked until it agrees.
        """
        self._control.kill()
        self._check_version()
        end = self._clock.now() + deadline
        _, safety_mode = ur5_network.ask_modes(self._host)
        if safety_mode == SafetyMode.PROTECTIVE_STOP:
            unlock = ("close safety popup", "unlock protective stop")
            while "releasing" not in (reply := ur5_network.ask_dashboard(self._host, *unlock)[1]):
                if self._clock.now() > end:
                    raise DeviceTimeout(
                        f"the protective stop was not released within {deadline:.0f} s; the "
                        f"controller says: {reply}"
                    )
                self._clock.sleep(0.25)
        ur5_network.ask_dashboard(self._host, "stop")

    # --- states -------------------------------------------------------------------------------

    def sample(self) -> Sample:
        """The next state. When none comes, the link is over."""
        self._looks.append(self._clock.now())
        sample: Sample | None = self._control.call("sample", deadline=1.0)
        if sample is None:
            self._control.kill()
            raise DeviceUnreachable(
                f"no state came from the arm at {self._host} for half a second, the connection is "
                "given up: check cable and controller, then call recover()"
            )
        return replace(sample, stamp=self._stamps.stamp(sample.timestamp, self._clock.now()))

    def at_rest(self, *, until: float) -> Sample:
        """The first state in which the arm stands still. Raises DeviceTimeout."""
        self.sample()  # may have been under way before the call
        while np.abs((sample := self.sample()).qd).max() > AT_REST:
            if self._clock.now() > until:
                raise DeviceTimeout("the arm did not come to rest in time and was stopped")
        return sample

    # --- motion -------------------------------------------------------------------------------

    def require_open(self) -> None:
        """Raises DeviceUnreachable before `open`, and after the link was given up."""
        self._control.require_started()

    def start(
        self, request: str, numbers: tuple[float, ...], speed: float, acceleration: float
    ) -> int:
        """Begin a motion; the number of the operation before it. Raises what forbids it."""
        self._looks.clear()  # until now the child kicked the watchdog by itself
        before = self.sample()
        if motion_problem(before):
            raise self.cause("before the motion")
        if not self._control.call(request, numbers, speed, acceleration):
            raise self.cause("at the start of the motion")
        return before.operation

    def watch(self, motion: str) -> Sample:
        """The next state while a motion is under way. Raises what has stopped it."""
        sample = self.sample()
        if motion_problem(sample):
            # The first state after a long gap may still be of before the stop.
            looks = [*self._looks, self._clock.now()]
            unwatched = max(later - look for look, later in pairwise(looks))
            raise self.cause(f"during {motion}", unwatched=unwatched)
        return sample

    def brake(self, deceleration: float) -> Sample:
        """Come to rest at `deceleration`, rad/s^2."""
        self._control.call("stop", deceleration, deadline=STOP_DEADLINE)
        return self.at_rest(until=self._clock.now() + STOP_DEADLINE)

    def halt(self, deceleration: float) -> None:
        """Bring the arm to rest; if it does not obey, by the end of its program.

        When the controller hears nothing at all any more, its watchdog ends the program.
        """
        try:
            self.brake(deceleration)
        except DeviceError:
            self._control.kill()
            self.stop_program()

    def stop_program(self) -> None:
        """For good: what ran cannot be resumed."""
        with contextlib.suppress(DeviceError):
            ur5_network.ask_dashboard(self._host, "stop", deadline=1.0)

    # --- causes -------------------------------------------------------------------------------

    def cause(self, when: str, *, unwatched: float = 0.0) -> ArmError:
        """Why the arm does not move, as a typed error; the program is stopped for good.

        States that come within a tenth of a second may name it better than the first.
        unwatched: s for which nobody looked at the motion before it was found stopped.
        """
        for _ in range(CAUSE_SAMPLES):
            sample = self.sample()
            problem = motion_problem(sample)
            if problem is not None and not isinstance(problem, ProgramStopped):
                break
        where = (
            f"{when}, with the tool at {np.round(sample.pose[:3], 3).tolist()} m and a force of "
            f"{np.linalg.norm(sample.force):.0f} N"
        )
        if problem is None:
            return ArmError(f"no cause is reported {where}: look at the arm and its log")
        self.stop_program()
        if isinstance(problem, ProgramStopped):
            problem = self._why_stopped(unwatched) or problem
        return type(problem)(f"{problem} ({where})")

    def _why_stopped(self, unwatched: float) -> ArmError | None:
        """What stops a program besides a person: local control, and the watchdog."""
        with contextlib.suppress(DeviceError):
            if self._is_local():
                return _local_control()
        if unwatched > 1 / WATCHDOG:
            return ArmError(
                f"the controller's watchdog stopped the arm: this process did not look at it for "
                f"{unwatched:.2f} s ({1 / WATCHDOG:.2f} s are allowed): let `on_state` do "
                "less, or give the process more of the machine; then call recover()"
            )
        return None

    def _is_local(self) -> bool:
        has_switch = self.version.has_remote_control
        return has_switch and not ur5_network.ask_remote_control(self._host)


def _start_problem(text: str) -> ArmError:
    if "already in use" in text:
        return ArmError(
            "the controller's input registers are in use: end the other program that controls "
            "this arm, or disable EtherNet/IP, PROFINET and MODBUS in the installation "
            f"({text})"
        )
    return ArmError(f"the driver's program did not start on the controller: {text}")


def _local_control() -> ArmError:
    return ArmError(
        "remote control is off: switch the controller to remote control at the upper right of "
        "the pendant, then call recover()"
    )
