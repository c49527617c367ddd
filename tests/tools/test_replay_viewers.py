"""What viewers get: read by Rerun's own reader, and by a client of Foxglove's protocol."""

from __future__ import annotations

import base64
import json
import struct
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from kinematic_log import write_log
from mcap.reader import make_reader

from policies.baselines import RandomPolicy
from policies.shipped import NamedPolicy
from tools.replay.cli import main

POLICY = NamedPolicy(name="random", decider=RandomPolicy(), sha256=None)
Message = tuple[str, int, int, bytes]  # topic, log time, publish time, content
DEADLINE = 60  # s


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("logs") / "a.mcap", POLICY, actions=2).path


def messages_of(log: Path) -> list[Message]:
    with log.open("rb") as file:
        return [
            (channel.topic, message.log_time, message.publish_time, message.data)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]


def channels_of(log: Path) -> dict[str, tuple[str, str, str, bytes]]:
    """By topic: encoding of messages; name, encoding and text of the schema."""
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = summary.schemas
    return {
        one.topic: (
            one.message_encoding, schemas[one.schema_id].name, schemas[one.schema_id].encoding,
            schemas[one.schema_id].data,
        )
        for one in summary.channels.values()
    }  # fmt: skip


# --- Rerun ------------------------------------------------------------------------------------


def read_rrd(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """By entity: rows with a place on the timeline of measurement, in order."""
    reader = pytest.importorskip("rerun.chunk").RrdReader(path)
    assert len(reader.blueprints()) == 1
    rows = defaultdict(list)
    for chunk in reader.stream():
        if "message_publish_time" in chunk.timeline_names:
            for row in chunk.to_record_batch().to_pylist():
                time = row.pop("message_publish_time").value
                rows[chunk.entity_path].append((time, row))
    return {entity: sorted(found, key=lambda row: row[0]) for entity, found in rows.items()}


def curve(rows: list[tuple[int, dict[str, Any]]]) -> list[tuple[int, float]]:
    return [(time, row["Scalars:scalars"][0]) for time, row in rows]


@pytest.mark.slow
def test_rerun_reads_every_message_and_our_curves(log: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    assert main([str(log), "--rrd", str(tmp_path / "a.rrd")]) == 0
    entities, messages = read_rrd(tmp_path / "a.rrd"), messages_of(log)
    assert {
        topic: len(entities.get(topic, [])) for topic in {topic for topic, *_ in messages}
    } == Counter(topic for topic, *_ in messages)
    force = [
        (t, json.loads(data)["norm"]) for topic, _, t, data in messages if topic == "/tool/force"
    ]
    width = [
        (t, json.loads(data)["width"]) for topic, _, t, data in messages if topic == "/gripper"
    ]
    assert curve(entities["/measured/force"]) == force
    assert curve(entities["/measured/fingers"]) == [(t, 1000 * metres) for t, metres in width]
    told = sum(topic in ("/decision", "/refusal", "/outcome") for topic, *_ in messages)
    assert len(entities["/told"]) == told


def test_rerun_gets_what_can_be_read_of_a_damaged_log(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rerun")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: 2 * log.stat().st_size // 3])
    assert main([str(cut), "--rrd", str(tmp_path / "cut.rrd")]) == 3
    assert "damaged at byte" in capsys.readouterr().out
    entities = read_rrd(tmp_path / "cut.rrd")
    assert entities["/camera/color"]
    assert entities["/told"]


def test_a_recording_that_cannot_be_written(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rerun")
    assert main([str(log), "--rrd", str(tmp_path / "nowhere" / "a.rrd")]) == 2
    assert "cannot be written" in capsys.readouterr().out


def test_a_viewer_that_does_not_start(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rerun")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    assert main([str(log), "--rerun"]) == 2
    assert "no viewer takes the episode" in capsys.readouterr().out


# --- Foxglove ---------------------------------------------------------------------------------

SERVE = """
import sys
from pathlib import Path
from rich.console import Console
from tdpg_deploy.episode_log.reader import read_episode
from tools.replay.to_foxglove import serve
serve(read_episode(Path(sys.argv[1])), Console(width=500), speed=1.0, port=0)
"""
PLAY, PAUSE = 0, 1  # commands
PLAYING, PAUSED, ENDED = 0, 1, 3  # states


class Client:
    """A viewer, as the protocol foxglove.sdk.v1 has it."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self.channels: dict[int, dict[str, Any]] = {}
        self.capabilities: list[str] = []
        self.messages: list[tuple[str, int, bytes]] = []
        self.states: list[tuple[int, int, bool]] = []  # status, time, whether it was moved there

    def read(self) -> None:
        answer = self._socket.recv(timeout=DEADLINE)
        if isinstance(answer, str):
            told = json.loads(answer)
            self.capabilities += told.get("capabilities", [])
            self.channels |= {channel["id"]: channel for channel in told.get("channels", [])}
        elif answer[0] == 1:
            number, log_time = struct.unpack_from("<IQ", answer, 1)
            self.messages.append((self.channels[number]["topic"], log_time, answer[13:]))
        elif answer[0] == 5:
            status, time, _, moved = struct.unpack_from("<BQf?", answer, 1)
            self.states.append((status, time, moved))

    def subscribe(self) -> None:
        wanted = [{"id": number, "channelId": number} for number in self.channels]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def control(self, command: int, *, speed: float = 1.0, seek: int | None = None) -> None:
        """And wait for the answer; what came before is forgotten."""
        moved = seek is not None
        self._socket.send(struct.pack("<BBf?QI", 3, command, speed, moved, seek or 0, 1) + b"a")
        self.states.clear()
        while not self.states:
            self.messages.clear()
            self.read()


def advertised(channel: dict[str, Any]) -> tuple[str, str, str, bytes]:
    """As `channels_of` has it. Binary schemas come in base 64."""
    text, encoding = channel["schema"], channel["schemaEncoding"]
    schema = base64.b64decode(text) if encoding == "protobuf" else text.encode()
    return channel["encoding"], channel["schemaName"], encoding, schema


@contextmanager
def foxglove_client(log: Path) -> Iterator[Client]:
    pytest.importorskip("foxglove")
    connect = pytest.importorskip("websockets.sync.client").connect
    command = [sys.executable, "-u", "-c", SERVE, str(log)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        address = server.stdout.readline().split("open Foxglove on ")[1].split(",")[0]
        try:
            with connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
                yield Client(socket)
        finally:
            server.kill()


@pytest.mark.slow
def test_foxglove_plays_pauses_and_seeks(log: Path) -> None:
    messages = [(topic, log_time, data) for topic, log_time, _, data in messages_of(log)]
    start, middle = messages[0][1], messages[len(messages) // 2][1]
    with foxglove_client(log) as client:
        described = channels_of(log)
        while len(client.channels) < len(described):
            client.read()
        assert {one["topic"]: advertised(one) for one in client.channels.values()} == described
        assert set(client.capabilities) == {"playbackControl", "time"}
        client.subscribe()

        client.control(PAUSE, seek=middle)
        assert client.states == [(PAUSED, middle, True)]
        last = {message[0]: message for message in messages if message[1] <= middle}
        while {message[0]: message for message in client.messages} != last:
            client.read()
        assert {log_time <= middle for _, log_time, _ in client.messages} == {True}

        client.control(PLAY, speed=float("nan"))  # nonsense does no harm
        client.control(PLAY, speed=20.0, seek=start)
        while len(client.messages) < len(messages):
            client.read()
        assert client.messages == messages

        client.control(PLAY, seek=messages[-1][1] + 10**9)
        assert client.states == [(ENDED, messages[-1][1], True)]
