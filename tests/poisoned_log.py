"""Logs that mean harm: files of right shape and with right checksums, whose contents are chosen to
hurt whoever reads or shows them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import Writer

from tdpg_deploy.episode_log import channels

HOSTILE = "<b>&\"'</script><script>document.title='owned'</script>"

TEXTS = [
    "", HOSTILE, "../../../etc/passwd", "C:\\..\\x", "\u202e\x00\u2028\ud800",
    "\x1b]0;owned\x07\x1b[2J", "[/x]", "x" * 10_000_000, "a\n" * 1000,
]  # fmt: skip
NUMBERS = [0, -1, 2**31, 2**63, -(2**63), 1e308, -1e308, 5e-324, float("nan"), float("inf"), 1e-9]
VALUES: list[Any] = [
    None, True, *NUMBERS, *TEXTS, [], [[]], {}, {"kind": "Push"}, [1e308] * 1000, [0.5] * 100_000,
]  # fmt: skip
BYTES = [b"", b"\x00", b"\x89PNG\r\n\x1a\n" + b"\xff" * 40, b"\xff\xd8\xff", b"\xff" * 100_000]
DEEP = b"[" * 100_000
LONG = b"1" + b"0" * 5000  # more digits than Python reads

Rng = np.random.Generator
Item = tuple[Schema, Channel, Message]


def poison_file(source: Path, target: Path, rng: Rng) -> None:
    """`target` is `source` with something wrong: one thing, or many, or their order."""
    with source.open("rb") as stream:
        reader = make_reader(stream)
        metadata, attachments = list(reader.iter_metadata()), list(reader.iter_attachments())
        items = [
            (schema, channel, message)
            for schema, channel, message in reader.iter_messages(log_time_order=False)
            if schema is not None
        ]
    share = rng.choice([0.0, 0.01, 0.15])  # of contents that are changed
    with target.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for one in metadata:
            content = {
                key: poisoned_text(value, rng) if rng.random() < share / 3 else value
                for key, value in one.metadata.items()
            }
            writer.add_metadata(one.name, content)
        for attached in attachments:
            data = poisoned_json(attached.data, rng) if rng.random() < share else attached.data
            times = attached.create_time, attached.log_time
            writer.add_attachment(*times, attached.name, attached.media_type, data)
        disorder = share == 0 or rng.random() < 0.5
        _write(writer, shuffled(items, rng) if disorder else items, share, rng)
        writer.finish()  # type: ignore[no-untyped-call]


def _write(writer: Writer, items: list[Item], share: float, rng: Rng) -> None:
    numbers: dict[int, int] = {}
    lies = rng.random() < 0.1
    for schema, channel, message in items:
        if channel.id not in numbers:
            encoding, text = channel.message_encoding, schema.data
            if lies and rng.random() < 0.3:
                encoding, text = str(rng.choice(["json", "protobuf", "ros1", HOSTILE])), b"\xff{"
            number = writer.register_schema(schema.name, schema.encoding, text)
            numbers[channel.id] = writer.register_channel(channel.topic, encoding, number)
        data = message.data
        if rng.random() < share:
            data = poisoned(channel.topic, data, rng)
        times = message.log_time, message.publish_time
        if rng.random() < share / 10:
            times = int(rng.choice([0, 2**63 - 1])), int(rng.choice([0, 2**63 - 1]))
        writer.add_message(numbers[channel.id], times[0], data, times[1])


def shuffled(items: list[Item], rng: Rng) -> list[Item]:
    """Some lost, repeated, elsewhere, or on another's channel."""
    at, to = (int(rng.integers(len(items))) for _ in range(2))
    match rng.integers(6):
        case 0:
            return [*items[:at], *items[at + 1 :]]
        case 1:
            return [*items[:at], *[items[at]] * int(rng.integers(2, 50)), *items[at + 1 :]]
        case 2:
            rest = [*items[:at], *items[at + 1 :]]
            return [*rest[:to], items[at], *rest[to:]]
        case 3:
            return [items[i] for i in rng.permutation(len(items))]
        case 4:
            topic = items[at][1].topic
            return [item for item in items if item[1].topic != topic]
        case _:
            (schema, channel, _), (_, _, message) = items[at], items[to]
            return [*items[:at], (schema, channel, message), *items[at + 1 :]]


def poisoned(topic: str, data: bytes, rng: Rng) -> bytes:
    if rng.random() < 0.05:
        return DEEP if rng.random() < 0.5 else bytes(rng.bytes(200))
    if topic not in channels.PROTOBUF:
        return poisoned_json(data, rng)
    try:
        return poisoned_protobuf(channels.PROTOBUF[topic].FromString(data), rng)
    except DecodeError:  # another's content
        return data


def poisoned_text(text: str, rng: Rng) -> str:
    values = [*TEXTS, *map(str, NUMBERS), LONG.decode(), text + HOSTILE]
    return values[int(rng.integers(len(values)))].encode(errors="replace").decode()


def poisoned_json(data: bytes, rng: Rng) -> bytes:
    """One leaf, or one branch, is another, or lost. Text that is not JSON is cut or grows."""
    try:
        document = json.loads(data)
    except ValueError:
        return data[: int(rng.integers(len(data) + 1))] + bytes(rng.choice([b"", b"[[object]]\n"]))
    if rng.random() < 0.02:
        return LONG
    return json.dumps(_poisoned_value(document, rng)).encode()


def _poisoned_value(value: Any, rng: Rng) -> Any:
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = str(rng.choice(sorted(value)))
        if rng.random() < 0.1:
            return {other: item for other, item in value.items() if other != key}
        return value | {key: _poisoned_value(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.9:
        at = int(rng.integers(len(value)))
        return [*value[:at], _poisoned_value(value[at], rng), *value[at + 1 :]]
    return VALUES[int(rng.integers(len(VALUES)))]


def poisoned_protobuf(message: Any, rng: Rng) -> bytes:
    """One field, at any depth, is another."""
    holder, field = _any_field(message, rng)
    fits = [value for value in _values(field) if _accepts(holder, field, value)]
    _put(holder, field, fits[int(rng.integers(len(fits)))] if fits else None)
    return bytes(message.SerializeToString())


def _any_field(message: Any, rng: Rng) -> tuple[Any, FieldDescriptor]:
    fields = message.DESCRIPTOR.fields
    field = fields[int(rng.integers(len(fields)))]
    if field.message_type is not None and rng.random() < 0.9:
        inner = getattr(message, field.name)
        if not field.is_repeated:
            return _any_field(inner, rng)
        if len(inner):
            return _any_field(inner[int(rng.integers(len(inner)))], rng)
    return message, field


def _values(field: FieldDescriptor) -> list[Any]:
    values: dict[type, list[Any]] = {str: list(TEXTS), bytes: list(BYTES)}
    return values.get(type(field.default_value), [*NUMBERS, 1, 7])


def _accepts(holder: Any, field: FieldDescriptor, value: Any) -> bool:
    trial = type(holder)()
    try:
        _put(trial, field, value)
    except (TypeError, ValueError, OverflowError):
        return False
    return True


def _put(holder: Any, field: FieldDescriptor, value: Any) -> None:
    """None empties the field; a list repeats what it holds."""
    if value is None or field.message_type is not None:
        holder.ClearField(field.name)
    elif field.is_repeated:
        getattr(holder, field.name).append(value)
    else:
        setattr(holder, field.name, value)
