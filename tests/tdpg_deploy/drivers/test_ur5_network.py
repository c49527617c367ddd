"""First words with peers that behave and misbehave, against bytes written by hand."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from ur_rig import new_host

from tdpg_deploy.drivers import ur5_network
from tdpg_deploy.drivers.ur5_network import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT
from tdpg_deploy.drivers.ur5_status import ControllerVersion, RobotMode, SafetyMode
from tdpg_deploy.errors import ArmError, DeviceTimeout, DeviceUnreachable

GREETING = b"Connected: Universal Robots Dashboard Server\n"


@contextmanager
def peer(port: int, talk: Callable[[socket.socket], None]) -> Iterator[str]:
    """An address where one client after the other is talked to on `port`."""
    host = new_host()
    with socket.create_server((host, port)) as server:
        server.settimeout(0.05)
        done = threading.Event()

        def serve() -> None:
            while not done.is_set():
                try:
                    client, _ = server.accept()
                except TimeoutError:
                    continue
                with client:
                    client.settimeout(2.0)
                    talk(client)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield host
        finally:
            done.set()
            thread.join()


def dashboard(**replies: str) -> Callable[[socket.socket], None]:
    def talk(client: socket.socket) -> None:
        client.sendall(GREETING)
        with client.makefile("rb") as lines:
            for line in lines:
                client.sendall((replies[line.decode().strip()] + "\n").encode())

    return talk


def test_dashboard_replies_may_come_in_pieces() -> None:
    def talk(client: socket.socket) -> None:
        for piece in (GREETING[:5], GREETING[5:]):
            client.sendall(piece)
        assert client.recv(100) == b"stop\n"
        client.sendall(b"Stop")
        client.sendall(b"ped\n")

    with peer(DASHBOARD_PORT, talk) as host:
        assert ur5_network.ask_dashboard(host, "stop") == ["Stopped"]


@pytest.mark.parametrize(
    ("robot", "safety", "modes"),
    [
        ("Robotmode: RUNNING", "Safetymode: NORMAL", (RobotMode.RUNNING, SafetyMode.NORMAL)),
        ("Robotmode: POWER_OFF", "Safetymode: ROBOT_EMERGENCY_STOP", (3, 7)),
        ("Robotmode: DANCING", "?", (RobotMode.NO_CONTROLLER, SafetyMode.UNDEFINED)),
    ],
)
def test_modes(robot: str, safety: str, modes: tuple[int, int]) -> None:
    with peer(DASHBOARD_PORT, dashboard(robotmode=robot, safetymode=safety)) as host:
        assert ur5_network.ask_modes(host) == modes


@pytest.mark.parametrize("reply", ["true", "false"])
def test_remote_control(reply: str) -> None:
    with peer(DASHBOARD_PORT, dashboard(**{"is in remote control": reply})) as host:
        assert ur5_network.ask_remote_control(host) is (reply == "true")


def test_version() -> None:
    def talk(client: socket.socket) -> None:
        assert client.recv(100) == bytes.fromhex("0005 56 0002")
        client.sendall(bytes.fromhex("0004 56 01"))
        assert client.recv(100) == bytes.fromhex("0003 76")
        client.sendall(struct.pack(">HB4I", 19, ord("v"), 5, 11, 1, 108318))

    with peer(RTDE_PORT, talk) as host:
        assert ur5_network.ask_version(host) == ControllerVersion(
            major=5, minor=11, bugfix=1, build=108318
        )


def rtde(*answers: bytes) -> Callable[[socket.socket], None]:
    """One answer a request."""

    def talk(client: socket.socket) -> None:
        for answer in answers:
            client.recv(100)
            client.sendall(answer)
        client.recv(100)  # until the asker has read it all, and hangs up

    return talk


ACCEPTED = bytes.fromhex("0004 56 01")
VERSION = struct.pack(">HB4I", 19, ord("v"), 3, 15, 8, 106339)


def test_text_messages_may_come_before_an_answer() -> None:
    text = bytes.fromhex("000a 4d 02 6869 02 5552 00")
    with peer(RTDE_PORT, rtde(text + ACCEPTED, text + VERSION)) as host:
        assert str(ur5_network.ask_version(host)) == "3.15.8.106339"


def test_controller_that_is_too_old_for_the_protocol() -> None:
    with (
        peer(RTDE_PORT, rtde(bytes.fromhex("0004 56 00"))) as host,
        pytest.raises(ArmError, match="does not speak version 2 of RTDE: update"),
    ):
        ur5_network.ask_version(host)


@pytest.mark.parametrize(
    "answers",
    [
        [b"HTTP/1.1 400 Bad Request\r\n\r\n"],
        [bytes.fromhex("0002 56")],
        [ACCEPTED, VERSION[:2] + b"x" + VERSION[3:]],
        [ACCEPTED, bytes.fromhex("0005 76 0003")],
    ],
    ids=["another service", "shorter than a header", "another kind", "another size"],
)
def test_peer_that_is_no_controller(answers: list[bytes]) -> None:
    with (
        peer(RTDE_PORT, rtde(*answers)) as host,
        pytest.raises(DeviceUnreachable, match=r"no UR controller would: is arm\.host right"),
    ):
        ur5_network.ask_version(host)


def test_nobody_listens() -> None:
    host = new_host()
    for ask in (ur5_network.ask_version, ur5_network.ask_modes, ur5_network.check_script_port):
        with pytest.raises(DeviceUnreachable, match=f"{host}.*refused.*switched on"):
            ask(host)


def test_peer_that_never_answers() -> None:
    def talk(client: socket.socket) -> None:
        client.recv(100)
        client.recv(100)  # until the asker gives up

    with (
        peer(RTDE_PORT, talk) as host,
        pytest.raises(DeviceTimeout, match="does not answer: it is booting or hangs"),
    ):
        ur5_network.ask_version(host, deadline=0.1)


def test_peer_that_hangs_up() -> None:
    with (
        peer(DASHBOARD_PORT, lambda client: None) as host,
        pytest.raises(DeviceUnreachable, match="closed by the controller"),
    ):
        ur5_network.ask_dashboard(host, "stop")


def test_peer_that_resets() -> None:
    def talk(client: socket.socket) -> None:
        client.recv(1)  # once the client has connected for sure and asked
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

    with peer(RTDE_PORT, talk) as host, pytest.raises(DeviceUnreachable, match="lost"):
        ur5_network.ask_version(host)


@pytest.mark.parametrize("error", [TimeoutError(), OSError(113, "No route to host")])
def test_peer_out_of_reach(error: OSError, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object, **options: object) -> None:
        raise error

    monkeypatch.setattr(socket, "create_connection", fail)
    expected = DeviceTimeout if isinstance(error, TimeoutError) else DeviceUnreachable
    with pytest.raises(expected, match=r"is arm\.host right\?"):
        ur5_network.ask_version(new_host())


def test_peer_that_is_gone_before_it_is_asked() -> None:
    with peer(DASHBOARD_PORT, lambda client: None) as host:
        connection = ur5_network.Connection(host, DASHBOARD_PORT, deadline=2.0)
        with connection, pytest.raises(DeviceUnreachable, match="lost"):
            connection.send(bytes(10_000_000))  # more than buffers hold


def test_script_port() -> None:
    with peer(SCRIPT_PORT, lambda client: None) as host:
        ur5_network.check_script_port(host)
