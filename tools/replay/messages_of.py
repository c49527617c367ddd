"""A log as raw messages, for viewers that speak its formats."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from mcap.records import Channel, Message, Schema

from tdpg_deploy.episode_log import channels
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.episode_log.records import chunks_of, read_records
from tdpg_deploy.errors import LogError


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
    with episode.path.open("rb") as file:
        skip = {} if images else chunks_of(file, channels.IMAGES)
        file.seek(0)
        for record in read_records(file, skip=skip):
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
    with episode.path.open("rb") as file:
        for record in read_records(file):
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
    raise LogError(f"{episode.path}: the log has no step {number}, only {steps}")
