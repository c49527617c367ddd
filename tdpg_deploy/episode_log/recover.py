"""Is a log whole, and if not, what can be saved? For any MCAP file; nothing is trusted."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import Writer

from tdpg_deploy import __version__
from tdpg_deploy.episode_log.channels import chunk_of
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.episode_log.records import read_records
from tdpg_deploy.errors import LogError


class Condition(Enum):
    """The value is the exit code, as `mcap recover` has it."""

    WHOLE = 0
    NOTHING = 1
    LOSSY = 3


@dataclass(frozen=True, kw_only=True)
class Report:
    """messages: that can be read. damage: what is wrong, in file order."""

    messages: int
    damage: tuple[str, ...]

    @property
    def condition(self) -> Condition:
        if not self.damage:
            return Condition.WHOLE
        return Condition.LOSSY if self.messages else Condition.NOTHING


def check(path: Path) -> Report:
    """Read all of a log, compare every checksum and decode every entry."""
    damage: list[str] = []
    messages = sum(isinstance(record, Message) for record in _salvage(path, damage))
    if not damage:
        try:
            episode = read_episode(path)
        except LogError as error:
            return Report(messages=0, damage=(str(error),))
        try:
            for _ in episode.entries():
                pass
        except LogError as error:
            damage.append(str(error))
    return Report(messages=messages, damage=tuple(damage))


def recover(path: Path, target: Path) -> Report:
    """Copy what can be read of `path` into a sound file `target`; no file if that is nothing.

    Raises LogError if `target` exists or cannot be written.
    """
    damage: list[str] = []
    part = target.with_name(target.name + ".part")
    if target.exists():
        raise LogError(f"{target}: exists already, and a log is never overwritten")
    try:
        with part.open("xb") as file:
            copy = _Copy(Writer(file, enable_data_crcs=True))
            for record in _salvage(path, damage):
                copy.add(record)
            copy.finish()
        if copy.lost:
            damage.append(f"{copy.lost} messages whose channel is lost")
        if copy.messages:
            part.replace(target)
    except OSError as error:
        raise LogError(f"{target}: cannot be written ({error.strerror})") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
    return Report(messages=copy.messages, damage=tuple(damage))


def _salvage(path: Path, damage: list[str]) -> Iterator[McapRecord]:
    """Every record that can be read; what cannot is told in `damage`."""
    try:
        with path.open("rb") as file:
            yield from read_records(file, on_damage=damage.append)
    except OSError as error:
        damage.append(f"cannot be read ({error.strerror})")
    except LogError as error:
        damage.append(str(error))


class _Copy:
    """Writes records anew: numbers of schemas and channels may change, nothing else does."""

    def __init__(self, writer: Writer) -> None:
        self.messages = 0
        self.lost = 0
        self._writer = writer
        self._schemas = {0: 0}
        self._channels: dict[int, int] = {}
        self._chunks: dict[int, str] = {}  # channel -> what its chunks hold
        self._chunk = ""
        writer.start(profile="tdpg", library=f"tdpg-deploy {__version__} recover")

    def add(self, record: McapRecord) -> None:
        if isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        elif isinstance(record, Schema) and record.id not in self._schemas:
            self._schemas[record.id] = self._writer.register_schema(
                record.name, record.encoding, record.data
            )
        elif isinstance(record, Channel) and record.id not in self._channels:
            self._add_channel(record)
        elif isinstance(record, Message):
            self._add_message(record)

    def finish(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _add_channel(self, channel: Channel) -> None:
        if channel.schema_id in self._schemas:
            self._channels[channel.id] = self._writer.register_channel(
                channel.topic,
                channel.message_encoding,
                self._schemas[channel.schema_id],
                channel.metadata,
            )
            self._chunks[channel.id] = chunk_of(channel.topic)

    def _add_message(self, message: Message) -> None:
        if message.channel_id not in self._channels:
            self.lost += 1
            return
        if self._chunks[message.channel_id] != self._chunk:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._chunk = self._chunks[message.channel_id]
        self._writer.add_message(
            self._channels[message.channel_id],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )
        self.messages += 1
