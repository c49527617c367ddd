"""The process that holds ur_rtde: `python -m tdpg_deploy.drivers.ur5_child <fd> <host>`.

ur_rtde's control interface reconnects by itself for ever, crashes or hangs when a link drops,
and after a reconnection repeats the command that failed. In a process of its own it can be
killed. It ends with the pipe to its parent.

While no motion runs this process kicks the controller's watchdog. While one runs, only the
parent's requests for samples do: if the parent, this process or the link dies or stalls, the
controller stops the program and with it the arm.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection

from tdpg_deploy.drivers.ur5_status import RuntimeState, Sample

FREQUENCY = 125.0  # Hz; both generations serve it
STALE_AFTER = 0.5  # s without a new state
_KICK_EVERY = 0.05  # s
_VARIABLES = (
    *("timestamp", "actual_q", "actual_qd", "actual_TCP_pose", "actual_TCP_force"),
    *("robot_mode", "safety_mode", "runtime_state", "target_speed_fraction"),
)


class Session:
    """Each public method is a request."""

    def __init__(self, host: str) -> None:
        from rtde_control import RTDEControlInterface
        from rtde_receive import RTDEReceiveInterface

        self._receive = RTDEReceiveInterface(host, FREQUENCY, list(_VARIABLES))
        self._control = RTDEControlInterface(host, FREQUENCY)
        self._timestamp = 0.0

    def set_up(
        self, tcp: Sequence[float], mass: float, cog: Sequence[float], watchdog: float
    ) -> bool:
        """TCP, payload, watchdog (Hz). False when the controller did not take one."""
        return bool(
            self._control.setTcp(list(tcp))
            and self._control.setPayload(mass, list(cog))
            and self._control.setWatchdog(watchdog)
        )

    def sample(self) -> Sample | None:
        """The next new state, or None when none came in time. Kicks the watchdog."""
        end = time.monotonic() + STALE_AFTER
        while (timestamp := self._receive.getTimestamp()) == self._timestamp:
            if time.monotonic() > end or not self._is_connected():
                return None
            time.sleep(0.001)
        self._timestamp = timestamp
        self.kick()
        progress = self._control.getAsyncOperationProgressEx()
        return Sample(
            timestamp=timestamp,
            q=tuple(self._receive.getActualQ()),
            qd=tuple(self._receive.getActualQd()),
            pose=tuple(self._receive.getActualTCPPose()),
            force=tuple(self._receive.getActualTCPForce()[:3]),
            robot_mode=self._receive.getRobotMode(),
            safety_mode=self._receive.getSafetyMode(),
            runtime_state=self._receive.getRuntimeState(),
            slider=self._receive.getTargetSpeedFraction(),
            operation=progress.operationId(),
            running=progress.isAsyncOperationRunning(),
        )

    def move_joints(self, q: Sequence[float], speed: float, acceleration: float) -> bool:
        return self._is_connected() and self._control.moveJ(list(q), speed, acceleration, True)

    def move_linear(self, pose: Sequence[float], speed: float, acceleration: float) -> bool:
        return self._is_connected() and self._control.moveL(list(pose), speed, acceleration, True)

    def stop(self, deceleration: float) -> None:
        """At `deceleration`, rad/s^2. stopL would run stopj, too, and give it m/s^2."""
        self._control.stopJ(deceleration)

    def kick(self) -> None:
        # On a program that does not run, ur_rtde would wait three seconds to send this.
        if self._receive.getRuntimeState() == RuntimeState.PLAYING and self._is_connected():
            self._control.kickWatchdog()

    @property
    def is_moving(self) -> bool:
        return bool(self._control.getAsyncOperationProgressEx().isAsyncOperationRunning())

    def _is_connected(self) -> bool:
        return bool(self._receive.isConnected() and self._control.isConnected())


def serve(connection: Connection, session: Session) -> None:
    """Answer (number, name, arguments) with (number, error text or None, result) until EOF."""
    while True:
        if connection.poll(_KICK_EVERY):
            number, name, arguments = connection.recv()
            try:
                result = getattr(session, name)(*arguments)
            except Exception as error:
                connection.send((number, str(error), None))
            else:
                connection.send((number, None, result))
        elif not session.is_moving:
            session.kick()


def main() -> None:
    connection = Connection(int(sys.argv[1]))
    with contextlib.suppress(EOFError, ConnectionError):  # the parent is gone
        try:
            session = Session(sys.argv[2])
        except Exception as error:
            connection.send((0, str(error), None))
        else:
            connection.send((0, None, None))
            serve(connection, session)
    os._exit(0)  # ur_rtde's destructors sleep for seconds, or hang


if __name__ == "__main__":
    main()
