"""Emulated UR controllers for tests: an address of their own, a clock at their pace, and a look
at what is left behind."""

from __future__ import annotations

import itertools
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tdpg_deploy.cell_config import DEFAULT_CELL, ArmSection, load_cell
from tdpg_deploy.drivers.ur5_network import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT
from tdpg_deploy.emulators.ur_controller.process import ControllerProcess

PORTS = (DASHBOARD_PORT, SCRIPT_PORT, RTDE_PORT)

_numbers = itertools.count()


class PacedClock:
    """hal.Clock of a cell that runs `pace` times as fast as the machine."""

    def __init__(self, pace: float) -> None:
        self._pace = pace

    def now(self) -> float:
        return time.monotonic() * self._pace

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds / self._pace)


def new_host() -> str:
    """A loopback address that no other test process uses: the controller's ports are fixed."""
    pid = os.getpid()
    return f"127.{pid >> 8 & 0xFF}.{pid & 0xFF}.{2 + next(_numbers) % 250}"


def arm_section(host: str, model: str = "ur5") -> ArmSection:
    return load_cell(DEFAULT_CELL).arm.model_copy(update={"host": host, "model": model})


@contextmanager
def emulated_controller(host: str, **options: object) -> Iterator[ControllerProcess]:
    """A controller that is gone afterwards, with every process that talked to it."""
    with ControllerProcess(host=host, **options) as robot:
        yield robot
    assert processes_of(host) == {}
    for port in PORTS:
        with socket.socket() as probe:
            assert probe.connect_ex((host, port)) != 0, f"{host}:{port} still listens"


def processes_of(host: str) -> dict[int, str]:
    """Command lines of running processes that name this address, by process id."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode("utf-8", "replace").split("\0")
        except OSError:  # ended meanwhile
            continue
        if host in words:
            found[int(path.parent.name)] = " ".join(words)
    return found


def wait_until(condition: Callable[[], bool], *, deadline: float = 30.0) -> None:
    end = time.monotonic() + deadline
    while not condition():
        assert time.monotonic() < end, "the condition did not come true in time"
        time.sleep(0.005)
