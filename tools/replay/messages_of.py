"""A log as raw messages, for viewers that speak its formats."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.records import Channel, Message, Schema

from tdpg_deploy.episode_log import channels
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.episode_log.recover import recover
from tdpg_deploy.errors import LogError


@contextmanager
def sound(episode: Episode) -> Iterator[tuple[Episode, list[LogError]]]:
    """For viewers with readers of their own: the episode, or what can be recovered of a damaged
    log, in a file for the time being; and the damage."""
    try:
        for _ in episode.records():
            pass
    except LogError as error:
        with TemporaryDirectory(prefix="tdpg-replay-") as folder:
            copy = Path(folder) / episode.path.name.removesuffix(".part")
            recover(episode.path, copy)
            yield read_episode(copy), [error]
    else:
        yield episode, []


@dataclass(frozen=True, kw_only=True)
class RawMessage:
    """log_time, publish_time: nanoseconds since the UNIX epoch."""

    channel: Channel
    schema: Schema | None
    log_time: int
    publish_time: int
    data: bytes

    @property
    def topic(self) -> str:
        return str(self.channel.topic)


def raw_messages(episode: Episode, *, images: bool = True) -> Iterator[RawMessage]:
    """In file order. Raises LogError at damage, after all that lies before it."""
    schemas: dict[int, Schema] = {}
    known: dict[int, Channel] = {}
    for record in episode.records(unread=frozenset() if images else channels.IMAGES):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            known[record.id] = record
        elif isinstance(record, Message) and record.channel_id in known:
            channel = known[record.channel_id]
            yield RawMessage(
                channel=channel,
                schema=schemas.get(channel.schema_id),
                log_time=record.log_time,
                publish_time=record.publish_time,
                data=record.data,
            )


def channels_of(episode: Episode) -> dict[str, tuple[Channel, Schema | None]]:
    """By topic: those that the log names before its first message."""
    schemas: dict[int, Schema] = {}
    found: dict[str, tuple[Channel, Schema | None]] = {}
    for record in episode.records():
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            found[record.topic] = record, schemas.get(record.schema_id)
        elif isinstance(record, Message):
            break
    return found


def start_of(episode: Episode, number: int) -> int:
    """Log time of the look that step `number` was decided on. Raises LogError."""
    steps, looked = 0, 0
    for message in raw_messages(episode, images=False):
        if message.topic == channels.LOOK:
            looked = message.log_time
        elif message.topic == channels.PLAN:
            steps += 1
            if steps == number:
                return looked
    raise LogError(f"{episode.path.name}: the log has no step {number}, only {steps}")
