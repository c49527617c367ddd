"""MCAP records from a stream that nobody vouches for.

The `mcap` package's own readers trust the lengths that they find: a flipped bit may ask them for
any amount of memory. Here no record and no unpacked chunk exceeds LIMIT, every checksum that the
file carries is compared, and whatever is wrong ends in a LogError that names the place.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
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


def read_records(stream: IO[bytes]) -> Iterator[McapRecord]:
    """Header, schemas, channels, messages, attachments, metadata, data end and footer, in file
    order; chunks are unpacked. Raises LogError where the stream is no MCAP, is cut off or
    altered; what was yielded before is sound.
    """
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise LogError("not an MCAP file: it does not start as one")
    checksum = zlib.crc32(MCAP0_MAGIC)  # of the data section, then of the summary
    at = len(MCAP0_MAGIC)
    while True:
        opcode, head, body = _read_frame(stream, at)
        try:
            record = _parse(opcode, body)
            if isinstance(record, Chunk):
                yield from _unpack(record)
            elif record is not None:
                yield record
        except _BROKEN as error:
            reason = str(error) or type(error).__name__
            raise LogError(f"damaged at byte {at}: {reason}") from error
        if isinstance(record, DataEnd):
            _compare(record.data_section_crc, checksum, "data section")
            checksum = 0
        elif isinstance(record, Footer):
            _compare(record.summary_crc, zlib.crc32(head + body[:-4], checksum), "summary")
            break
        else:
            checksum = zlib.crc32(body, zlib.crc32(head, checksum))
        at += len(head) + len(body)
    if stream.read(len(MCAP0_MAGIC) + 1) != MCAP0_MAGIC:
        raise LogError("the file does not end as an MCAP file does: cut off, or something follows")


class _Broken(Exception):
    """Contents of a record contradict each other."""


_BROKEN = (_Broken, McapError, struct.error, ValueError, zstandard.ZstdError)


def _read_frame(stream: IO[bytes], at: int) -> tuple[int, bytes, bytes]:
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise LogError(f"cut off at byte {at + len(head)}")
    opcode, length = _HEAD.unpack(head)
    if length > LIMIT:
        raise LogError(
            f"damaged at byte {at}: a record of {length} bytes; at most {LIMIT} are read"
        )
    body = stream.read(length)
    if len(body) < length:
        raise LogError(f"cut off at byte {at + len(head) + len(body)}")
    return opcode, head, body


def _parse(opcode: int, body: bytes) -> McapRecord | None:
    if opcode == Opcode.MESSAGE:
        if len(body) < _MESSAGE_HEAD:
            raise _Broken(f"a message of {len(body)} bytes")
        message: McapRecord = Message.read(ReadDataStream(io.BytesIO(body)), len(body))
        return message
    if opcode not in _PARSERS:
        return None
    if opcode == Opcode.ATTACHMENT:
        _compare(int.from_bytes(body[-4:], "little"), zlib.crc32(body[:-4]), "attachment")
    record: McapRecord = _PARSERS[opcode].read(ReadDataStream(io.BytesIO(body)))
    return record


def _unpack(chunk: Chunk) -> Iterator[McapRecord]:
    content = io.BytesIO(_decompress(chunk))
    _compare(chunk.uncompressed_crc, zlib.crc32(content.getbuffer()), "chunk")
    end = len(content.getbuffer())
    while content.tell() < end:
        opcode, _, body = _read_frame(content, content.tell())
        if opcode == Opcode.CHUNK:
            raise _Broken("a chunk within a chunk")
        record = _parse(opcode, body)
        if record is not None:
            yield record


def _decompress(chunk: Chunk) -> bytes:
    if chunk.uncompressed_size > LIMIT:
        raise _Broken(f"a chunk of {chunk.uncompressed_size} bytes; at most {LIMIT} are read")
    if chunk.compression == "":
        data = chunk.data
    elif chunk.compression == "zstd":
        # Data that state their own size are not held to max_output_size.
        if zstandard.frame_content_size(chunk.data) > chunk.uncompressed_size:
            raise _Broken("a chunk that is larger than it says")
        data = zstandard.ZstdDecompressor().decompress(
            chunk.data, max_output_size=chunk.uncompressed_size
        )
    else:
        raise _Broken(f"chunks compressed with {chunk.compression!r}; only zstd is read")
    if len(data) != chunk.uncompressed_size:
        raise _Broken(f"a chunk of {len(data)} bytes that should have {chunk.uncompressed_size}")
    return data


def _compare(expected: int, actual: int, what: str) -> None:
    """Zero means that the writer left the checksum out."""
    if expected not in (0, actual):
        raise LogError(f"the checksum of the {what} differs: the file was altered or damaged")
