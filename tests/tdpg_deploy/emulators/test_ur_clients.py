"""Clients that others wrote on the emulated controller: ur_rtde's three interfaces, and Universal
Robots' own RTDE client, which the package urpy carries."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from ur_rig import emulated_controller, new_host, wait_until
from urpy.rtde.rtde import RTDE

from tdpg_deploy.drivers.ur5_network import SCRIPT_PORT

SESSION = Path(__file__).with_name("ur_rtde_session.py")
OUTPUTS = {
    "timestamp": "DOUBLE",
    "actual_q": "VECTOR6D",
    "safety_status_bits": "UINT32",
    "runtime_state": "UINT32",
    "output_int_register_30": "INT32",
    "output_double_register_30": "DOUBLE",
}
INPUTS = {"input_int_register_30": "INT32", "input_double_register_30": "DOUBLE"}
ECHO = b"""def echo():
  while True:
    write_output_integer_register(30, read_input_integer_register(30))
    write_output_float_register(30, read_input_float_register(30))
    sync()
  end
end
"""
NORMAL, PLAYING = 1 << 0, 2  # RTDE guide: safety_status_bits, runtime_state


@pytest.mark.slow
@pytest.mark.parametrize("model", ["ur5", "ur5e"])
def test_ur_rtde(model: str) -> None:
    host = new_host()
    with emulated_controller(host, model=model, pace=2.0):
        command = [sys.executable, str(SESSION), host, model]
        result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=240)
        assert "all well" in result.stdout, result.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "version"), [("ur5", (3, 15, 8, 106339)), ("ur5e", (5, 11, 1, 108318))]
)
def test_universal_robots_own_client(model: str, version: tuple[int, ...]) -> None:
    host = new_host()
    with emulated_controller(host, model=model) as robot, rtde(host) as client:
        assert client.get_controller_version() == version
        frequency = 500 if version[0] == 5 else 125
        assert client.send_output_setup([*OUTPUTS], [*OUTPUTS.values()], frequency=frequency)
        registers = client.send_input_setup([*INPUTS], [*INPUTS.values()])
        with rtde(host) as second, pytest.raises(ValueError, match="already in use"):
            second.send_input_setup([*INPUTS])
        assert client.send_start()
        with socket.create_connection((host, SCRIPT_PORT), timeout=5.0) as connection:
            connection.sendall(ECHO)
            wait_until(lambda: robot.do("truth")["program"] == "echo")
        registers.input_int_register_30, registers.input_double_register_30 = -7, 0.125
        client.send(registers)
        first = client.receive()
        wait_until(lambda: client.receive().output_int_register_30 == -7)
        state = client.receive()
        assert state.output_double_register_30 == 0.125
        assert state.timestamp > first.timestamp
        assert state.actual_q == pytest.approx(robot.do("truth")["q"])
        assert (state.safety_status_bits, state.runtime_state) == (NORMAL, PLAYING)
        assert client.send_pause()


@contextmanager
def rtde(host: str) -> Iterator[RTDE]:
    client = RTDE(host)
    client.connect()  # negotiates version 2
    try:
        yield client
    finally:
        client.disconnect()
