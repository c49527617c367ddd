"""The child process's part without ur_rtde: what it answers, when it kicks the watchdog."""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Iterator
from multiprocessing.connection import Connection
from types import SimpleNamespace
from typing import Any

import pytest
from ur_rig import wait_until

from tdpg_deploy.drivers import ur5_child
from tdpg_deploy.drivers.ur5_child import Session, serve
from tdpg_deploy.drivers.ur5_status import RuntimeState

HOST = "127.0.0.9"


class FakeReceive:
    """As rtde_receive.RTDEReceiveInterface: a state that the test sets."""

    def __init__(self, host: str, frequency: float, variables: list[str]) -> None:
        assert (host, frequency) == (HOST, 125.0)
        assert "actual_TCP_force" in variables
        self.connected = True
        self.timestamp = 1.0
        self.runtime_state = RuntimeState.PLAYING
        for name in ("ActualQ", "ActualQd", "ActualTCPPose", "ActualTCPForce"):
            setattr(self, f"get{name}", lambda: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
        self.getRobotMode, self.getSafetyMode = (lambda: 7), (lambda: 1)
        self.getTargetSpeedFraction = lambda: 0.5

    def isConnected(self) -> bool:
        return self.connected

    def getTimestamp(self) -> float:
        return self.timestamp

    def getRuntimeState(self) -> int:
        return self.runtime_state


class FakeControl:
    """As rtde_control.RTDEControlInterface: remembers what it was told."""

    def __init__(self, host: str, frequency: float) -> None:
        assert (host, frequency) == (HOST, 125.0)
        self.connected = True
        self.running = False
        self.kicks = 0
        self.told: list[tuple[Any, ...]] = []

    def isConnected(self) -> bool:
        return self.connected

    def getAsyncOperationProgressEx(self) -> SimpleNamespace:
        return SimpleNamespace(operationId=lambda: 5, isAsyncOperationRunning=lambda: self.running)

    def kickWatchdog(self) -> None:
        self.kicks += 1

    def stopJ(self, deceleration: float) -> None:
        raise RuntimeError("no arm here")

    def __getattr__(self, name: str) -> Any:
        def tell(*arguments: Any) -> bool:
            self.told.append((name, *arguments))
            return True

        return tell


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> Session:
    interfaces = {"rtde_control": "RTDEControlInterface", "rtde_receive": "RTDEReceiveInterface"}
    for module, fake in zip(interfaces, (FakeControl, FakeReceive), strict=True):
        monkeypatch.setitem(sys.modules, module, SimpleNamespace(**{interfaces[module]: fake}))
    monkeypatch.setattr(ur5_child, "STALE_AFTER", 0.05)
    return Session(HOST)


def control_of(session: Session) -> FakeControl:
    return session._control  # type: ignore[no-any-return]


def receive_of(session: Session) -> FakeReceive:
    return session._receive  # type: ignore[no-any-return]


@pytest.fixture
def parent(session: Session) -> Iterator[Connection]:
    """The other end of `serve`, which ends with it."""
    ours, theirs = multiprocessing.Pipe()

    def run() -> None:
        with pytest.raises((EOFError, OSError)):
            serve(theirs, session)

    thread = threading.Thread(target=run)
    thread.start()
    yield ours
    ours.close()
    thread.join(5.0)
    assert not thread.is_alive()


def test_sample_is_new_and_kicks_the_watchdog(session: Session) -> None:
    sample = session.sample()
    assert sample is not None
    assert sample.force == (1.0, 2.0, 3.0)
    assert (sample.timestamp, sample.slider, sample.operation) == (1.0, 0.5, 5)
    assert control_of(session).kicks == 1
    assert session.sample() is None  # the same state again is none


def test_no_sample_without_connection(session: Session) -> None:
    session.sample()
    receive_of(session).connected = False
    assert session.sample() is None


def test_nothing_is_sent_to_a_lost_controller(session: Session) -> None:
    control_of(session).connected = False
    assert not session.move_joints([0.0] * 6, 1.0, 1.0)
    assert not session.move_linear([0.0] * 6, 1.0, 1.0)
    session.kick()
    assert control_of(session).told == []
    assert control_of(session).kicks == 0


def test_program_that_does_not_run_is_not_kicked(session: Session) -> None:
    receive_of(session).runtime_state = RuntimeState.PAUSED
    session.kick()
    assert control_of(session).kicks == 0


def test_motions_are_asynchronous(session: Session) -> None:
    assert session.move_joints((0.1,) * 6, 1.0, 2.0)
    assert session.move_linear((0.2,) * 6, 0.5, 3.0)
    assert session.set_up((0.0,) * 6, 0.9, (0.0, 0.0, 0.05), 4.0)
    assert control_of(session).told == [
        ("moveJ", [0.1] * 6, 1.0, 2.0, True),
        ("moveL", [0.2] * 6, 0.5, 3.0, True),
        ("setTcp", [0.0] * 6),
        ("setPayload", 0.9, [0.0, 0.0, 0.05]),
        ("setWatchdog", 4.0),
    ]


def test_answers_carry_the_requests_number(parent: Connection) -> None:
    parent.send((7, "move_joints", ([0.0] * 6, 1.0, 1.0)))
    assert parent.recv() == (7, None, True)
    parent.send((8, "stop", (10.0,)))
    assert parent.recv() == (8, "no arm here", None)


def test_watchdog_is_kicked_at_rest_only(session: Session, parent: Connection) -> None:
    control = control_of(session)
    wait_until(lambda: control.kicks >= 3)
    control.running = True
    parent.send((1, "set_up", ((0.0,) * 6, 1.0, (0.0,) * 3, 4.0)))
    parent.recv()  # what was under way is over
    kicks = control.kicks
    polls = threading.Event()
    polls.wait(4 * ur5_child._KICK_EVERY)
    assert control.kicks == kicks


@pytest.mark.parametrize("refused", [False, True])
def test_process_ends_with_its_parent(
    session: Session, monkeypatch: pytest.MonkeyPatch, refused: bool
) -> None:
    def open_session(host: str) -> Session:
        if refused:
            raise RuntimeError("registers are already in use")
        return session

    ours, theirs = multiprocessing.Pipe()
    ended: list[int] = []
    monkeypatch.setattr(ur5_child, "Session", open_session)
    monkeypatch.setattr(os, "_exit", ended.append)
    monkeypatch.setattr(sys, "argv", ["ur5_child", str(os.dup(theirs.fileno())), HOST])
    thread = threading.Thread(target=ur5_child.main)
    thread.start()
    assert ours.recv() == (0, "registers are already in use" if refused else None, None)
    ours.close()
    theirs.close()
    thread.join(5.0)
    assert ended == [0]
