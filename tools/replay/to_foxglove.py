"""Play a log live to Foxglove, which can pause it, change its speed and seek."""

from __future__ import annotations

import time
from importlib import import_module
from typing import Any

from mcap.records import Channel, Schema
from rich.console import Console

from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.errors import ConfigError
from tools.replay.messages_of import RawMessage, channels_of, raw_messages, start_of
from tools.replay.playhead import Playhead, play

PORT = 8765  # Foxglove's own default


def serve(
    episode: Episode, console: Console, *, speed: float, first: int = 1, port: int = PORT
) -> None:
    """Until Ctrl-C. On loopback only; port 0 takes any that is free. Raises ConfigError."""
    foxglove = _foxglove()
    times = [message.log_time for message in raw_messages(episode, images=False)]
    if not times:
        raise ConfigError(f"{episode.path}: an episode without messages cannot be played")
    start = times[0] if first == 1 else start_of(episode, first)
    playhead = Playhead(start, speed=speed, now=time.monotonic)
    playhead.control(play=False, speed=speed, seek=None)  # until somebody looks
    try:
        server = foxglove.start_server(
            name=episode.path.name,
            port=port,
            server_listener=_listener(foxglove, playhead, last=times[-1]),
            capabilities=[foxglove.Capability.PlaybackControl, foxglove.Capability.Time],
            playback_time_range=(times[0], times[-1]),
        )
    except RuntimeError as error:
        raise ConfigError(
            f"--foxglove: port {port} cannot be used ({error}). Does another replay run?"
        ) from error
    console.print(
        f"open Foxglove on ws://127.0.0.1:{server.port}, with the layout that the log carries "
        "(tdpg_deploy/episode_log/layouts/foxglove.json); Ctrl-C ends",
        soft_wrap=True,
    )
    channels = _Channels(foxglove)
    for channel, schema in channels_of(episode).values():
        channels.open(channel, schema)
    try:
        while True:
            if play(raw_messages(episode), channels.publish, playhead, time.sleep):
                _wait_for_jump(playhead)
    finally:
        server.stop()


def _foxglove() -> Any:
    try:
        return import_module("foxglove")
    except ImportError as error:
        raise ConfigError(
            "--foxglove needs foxglove-sdk: pip install 'tdpg-deploy[view]'"
        ) from error


def _wait_for_jump(playhead: Playhead) -> None:
    """All is played; the viewer may still seek."""
    jumps = playhead.jumps
    while playhead.jumps == jumps:
        time.sleep(0.1)


class _Channels:
    """The log's channels, as the server has them."""

    def __init__(self, foxglove: Any) -> None:
        self._foxglove = foxglove
        self._open: dict[str, Any] = {}

    def open(self, channel: Channel, schema: Schema | None) -> None:
        described = None
        if schema is not None:
            described = self._foxglove.Schema(
                name=schema.name, encoding=schema.encoding, data=schema.data
            )
        self._open[channel.topic] = self._foxglove.Channel(
            channel.topic, message_encoding=channel.message_encoding, schema=described
        )

    def publish(self, message: RawMessage) -> None:
        if message.topic not in self._open:  # a recovered file names some in its middle
            self.open(message.channel, message.schema)
        self._open[message.topic].log(message.data, log_time=message.log_time)


def _listener(foxglove: Any, playhead: Playhead, *, last: int) -> Any:
    websocket = foxglove.websocket

    class Listener(websocket.ServerListener):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            self._watched = False

        def on_subscribe(self, client: Any, channel: Any) -> None:
            """Start with the first; show the state of things to whoever comes later."""
            plays = playhead.playing or not self._watched
            self._watched = True
            playhead.control(play=plays, speed=playhead.speed, seek=playhead.time)

        def on_playback_control_request(self, request: Any) -> Any:
            plays = request.playback_command == websocket.PlaybackCommand.Play
            playhead.control(play=plays, speed=request.playback_speed, seek=request.seek_time)
            now = min(playhead.time, last)
            status = websocket.PlaybackStatus.Playing if plays else websocket.PlaybackStatus.Paused
            return websocket.PlaybackState(
                status=websocket.PlaybackStatus.Ended if now == last else status,
                current_time=now,
                playback_speed=playhead.speed,
                did_seek=request.seek_time is not None,
                request_id=request.request_id,
            )

    return Listener()
