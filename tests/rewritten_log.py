"""A log written anew with other contents, and all its checksums right."""

from __future__ import annotations

from collections.abc import Callable
from typing import IO

from mcap.reader import make_reader
from mcap.writer import Writer

Change = Callable[[str, bytes], bytes]  # (name or topic, content) -> content


def rewrite(source: IO[bytes], file: IO[bytes], change: Change) -> None:
    writer = Writer(file)
    writer.start()
    reader = make_reader(source)
    for metadata in reader.iter_metadata():
        content = {
            key: change(key, value.encode() or b"-").decode(errors="replace")
            for key, value in metadata.metadata.items()
        }
        writer.add_metadata(metadata.name, content)
    for a in reader.iter_attachments():
        data = change(a.name, a.data)
        writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, data)
    numbers: dict[int, int] = {}
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        assert schema is not None
        if channel.id not in numbers:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            numbers[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, number
            )
        data = change(channel.topic, message.data)
        writer.add_message(numbers[channel.id], message.log_time, data, message.publish_time)
    writer.finish()  # type: ignore[no-untyped-call]
