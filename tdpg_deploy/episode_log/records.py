"""MCAP records from a stream that nobody vouches for.

The `mcap` package's own readers trust the lengths that they find: a flipped bit may ask them for
any amount of memory. Here no record and no unpacked chunk exceeds LIMIT, every checksum that the
file carries is compared, and whatever is wrong ends in a LogError that names the place.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from typing import IO, Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

from tdpg_deploy.errors import LogError

LIMIT = 64 << 20  # bytes; the largest record that we write is a chunk of about 4 MB
_HEAD = struct.Struct("<BQ")  # opcode, length
_MESSAGE_HEAD = 22  # bytes before a message's data
_PARSERS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
    Opcode.DATA_END: DataEnd,
    Opcode.FOOTER: Footer,
}  # the summary's records repeat what the data section holds


def read_records(
    stream: IO[bytes], *, on_damage: Callable[[str], None] | None = None
) -> Iterator[McapRecord]:
    """Header, schemas, channels, messages, attachments, metadata, data end and footer, in file
    order; chunks are unpacked.

    Raises LogError where the stream is no MCAP, is cut off or altered; what was yielded before is
    sound. With `on_damage`, a record whose contents are damaged is reported there and skipped,
    and only the loss of the records' boundaries raises.
    """
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise LogError("not an MCAP file: it does not start as one")
    checksum = zlib.crc32(MCAP0_MAGIC)  # of the data section, then of the summary
    at = len(MCAP0_MAGIC)
    opcode = 0
    while opcode != Opcode.FOOTER:
        try:
            opcode, head, body = _read_frame(stream)
        except _Broken as error:
            raise LogError(f"damaged at byte {at}: {error}") from error
        try:
            yield from _contents(opcode, body)
            if opcode == Opcode.DATA_END:
                _compare(_checksum(body), checksum, "data section")
            elif opcode == Opcode.FOOTER:
                _compare(_checksum(body), zlib.crc32(head + body[:-4], checksum), "summary")
        except _UNREADABLE as error:
            problem = f"damaged at byte {at}: {str(error) or type(error).__name__}"
            if on_damage is None:
                raise LogError(problem) from error
            on_damage(problem)
        checksum = 0 if opcode == Opcode.DATA_END else zlib.crc32(head + body, checksum)
        at += len(head) + len(body)
    if stream.read(len(MCAP0_MAGIC) + 1) != MCAP0_MAGIC:
        raise LogError("the file does not end as an MCAP file does: cut off, or something follows")


class _Broken(Exception):
    """The bytes contradict themselves, or are missing."""


_UNREADABLE = (_Broken, McapError, struct.error, ValueError, OverflowError, zstandard.ZstdError)


def _read_frame(stream: IO[bytes]) -> tuple[int, bytes, bytes]:
    """Opcode; the record's head; the record's body."""
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise _Broken("cut off")
    opcode, length = _HEAD.unpack(head)
    if length > LIMIT:
        raise _Broken(f"a record of {length} bytes; at most {LIMIT} are read")
    body = stream.read(length)
    if len(body) < length:
        raise _Broken(f"cut off within a record of {length} bytes, after {len(body)}")
    return opcode, head, body


def _contents(opcode: int, body: bytes) -> Iterator[McapRecord]:
    """The record, or those within it if it is a chunk; nothing if it is of a kind that is new."""
    if opcode == Opcode.ATTACHMENT:
        _compare(_checksum(body), zlib.crc32(body[:-4]), "attachment")
    if opcode == Opcode.MESSAGE:
        if len(body) < _MESSAGE_HEAD:
            raise _Broken(f"a message of {len(body)} bytes")
        yield Message.read(ReadDataStream(io.BytesIO(body)), len(body))
    elif opcode in _PARSERS:
        record = _PARSERS[opcode].read(ReadDataStream(io.BytesIO(body)))
        if isinstance(record, Chunk):
            yield from _unpack(record)
        else:
            yield record


def _unpack(chunk: Chunk) -> Iterator[McapRecord]:
    data = _decompress(chunk)
    _compare(chunk.uncompressed_crc, zlib.crc32(data), "chunk")
    content = io.BytesIO(data)
    while content.tell() < len(data):
        opcode, _, body = _read_frame(content)
        if opcode == Opcode.CHUNK:
            raise _Broken("a chunk within a chunk")
        yield from _contents(opcode, body)


def _decompress(chunk: Chunk) -> bytes:
    if chunk.uncompressed_size > LIMIT:
        raise _Broken(f"a chunk of {chunk.uncompressed_size} bytes; at most {LIMIT} are read")
    if chunk.compression == "":
        data = chunk.data
    elif chunk.compression == "zstd":
        # A frame that states its own size is not held to max_output_size.
        if zstandard.frame_content_size(chunk.data) > chunk.uncompressed_size:
            raise _Broken("a chunk that is larger than it says")
        data = zstandard.ZstdDecompressor().decompress(
            chunk.data, max_output_size=chunk.uncompressed_size
        )
    else:
        raise _Broken(f"a chunk compressed with {chunk.compression!r}; only zstd is read")
    if len(data) != chunk.uncompressed_size:
        raise _Broken(f"a chunk of {len(data)} bytes that should have {chunk.uncompressed_size}")
    return data


def _checksum(body: bytes) -> int:
    """The CRC-32 that ends a record's body."""
    return int.from_bytes(body[-4:], "little")


def _compare(expected: int, actual: int, what: str) -> None:
    """Zero means that the writer left the checksum out."""
    if expected not in (0, actual):
        raise _Broken(f"the checksum of the {what} differs")
