"""A program of somebody who has a UR and ur_rtde, run against `argv[1]`, a "ur5" or "ur5e" by
`argv[2]`, in its own process:
ur_rtde may end a process that loses its link. Says "all well" at its end."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from types import ModuleType

import numpy as np
import numpy.typing as npt
from dashboard_client import DashboardClient
from rtde_control import Path, PathEntry, RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
from scipy.spatial.transform import Rotation
from ur_analytic_ik import ur5, ur5e

PARKED = [1, -1.9, 1.7, -1.4, -1.6, 0]


def main(host: str, model: str) -> None:
    major, pose_at = (3, pose_of(ur5)) if model == "ur5" else (5, pose_of(ur5e))
    control, receive = RTDEControlInterface(host), RTDEReceiveInterface(host)
    dashboard = DashboardClient(host)
    dashboard.connect()

    assert dashboard.robotmode() == "Robotmode: RUNNING"
    assert dashboard.running()
    assert dashboard.polyscopeVersion().startswith(f"{major}.")
    assert major == 3 or dashboard.isInRemoteControl()
    assert control.setPayload(1.25, [0.0, 0.0, 0.05])
    soon(lambda: near([receive.getPayload(), *receive.getPayloadCog()], [1.25, 0, 0, 0.05]))

    q = np.add(receive.getActualQ(), [0.3, 0.1, -0.1, 0.2, 0.1, 0.4])
    assert control.moveJ(list(q), 2.0, 4.0)
    soon(lambda: near(receive.getActualQ(), q))
    assert same_pose(receive.getActualTCPPose(), pose_at(q, 0.0))
    tcp = [0, 0, 0.163, 0, 0, 0]
    assert control.setTcp(tcp)
    assert near(control.getTCPOffset(), tcp)
    soon(lambda: same_pose(receive.getActualTCPPose(), pose_at(q, 0.163)))

    up = pose_at(q, 0.163)
    up[2] += 0.05
    assert control.moveL(up, 0.5, 2.0)
    soon(lambda: same_pose(receive.getActualTCPPose(), up))
    assert near(control.getInverseKinematics(up), receive.getActualQ())
    assert same_pose(control.getForwardKinematics(list(q), tcp), pose_at(q, 0.163))
    assert control.getInverseKinematicsHasSolution(up)
    assert not control.getInverseKinematicsHasSolution([3, 0, 0, 0, 0, 0])
    assert control.isPoseWithinSafetyLimits(up)
    assert control.isSteady()

    end = q - 0.1
    path = Path()
    for corner in (q + 0.1, end):
        joints = [*corner, 2.0, 4.0, 0.0]
        path.addEntry(PathEntry(PathEntry.MoveJ, PathEntry.PositionJoints, joints))
    assert control.movePath(path)
    soon(lambda: near(receive.getActualQ(), end))

    assert control.speedJ([0.3, 0, 0, 0, 0, 0], 2.0)
    soon(lambda: receive.getActualQ()[0] > end[0] + 0.02)
    assert control.speedStop()
    soon(lambda: near(receive.getActualQd(), np.zeros(6)))
    before = receive.getActualTCPPose()
    assert control.speedL([0, 0, 0.1, 0, 0, 0], 1.0)
    soon(lambda: receive.getActualTCPPose()[2] > before[2] + 0.005)
    assert control.speedStop()
    assert near(receive.getActualTCPPose()[:2], before[:2])

    q = np.array(receive.getActualQ())
    for target in np.linspace(q, q + 0.1, 40):
        begun = control.initPeriod()
        assert control.servoJ(list(target), 0, 0, 0.01, 0.05, 300)
        control.waitPeriod(begun)
    soon(lambda: near(receive.getActualQ(), q + 0.1))
    down = pose_at(q + 0.1, 0.163)
    down[2] -= 0.005
    assert control.servoL(down, 0, 0, 0.01, 0.05, 300)
    soon(lambda: same_pose(receive.getActualTCPPose(), down))
    assert control.servoStop()

    assert control.sendCustomScriptFunction("park", f"movej({PARKED}, v=3, a=9)")
    soon(lambda: near(receive.getActualQ(), PARKED))

    try:
        RTDEControlInterface(host)
    except RuntimeError as error:
        assert "already in use" in str(error)  # noqa: PT017
    else:
        raise AssertionError("a second control interface was let in")


def soon(condition: Callable[[], bool]) -> None:
    """The receive interface may be a state behind the control interface."""
    end = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def near(a: npt.ArrayLike, b: npt.ArrayLike) -> bool:
    return bool(np.allclose(a, b, atol=1e-4))


def same_pose(a: Sequence[float], b: Sequence[float]) -> bool:
    turn = Rotation.from_rotvec(a[3:]) * Rotation.from_rotvec(b[3:]).inv()
    return near(a[:3], b[:3]) and bool(turn.magnitude() < 1e-3)


def pose_of(arm: ModuleType) -> Callable[[Iterable[float], float], list[float]]:
    """UR's six numbers at joints, of a tool this long, by another library's kinematics."""

    def pose_at(q: Iterable[float], tool: float) -> list[float]:
        X = arm.forward_kinematics(*q)
        return [*(X[:3, 3] + X[:3, 2] * tool), *Rotation.from_matrix(X[:3, :3]).as_rotvec()]

    return pose_at


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
    print("all well", flush=True)  # noqa: T201
    os._exit(0)  # ur_rtde's destructors take seconds
