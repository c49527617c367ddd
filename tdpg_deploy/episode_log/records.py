"""MCAP records from a stream that nobody vouches for.

The `mcap` package's own readers trust the lengths that they find: a flipped bit may ask them for
any amount of memory. Here no record and no unpacked chunk exceeds LIMIT, every checksum that the
file carries is compared, and whatever is wrong ends in a LogError that names the place.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Set
from types import MappingProxyType
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
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, starts of summary and offsets, checksum
_CHUNK_INDEX = struct.Struct("<QQQQI")  # times, offset, length, bytes of the index offsets
_INDEX_OFFSET = struct.Struct("<HQ")  # channel, offset
_LENGTH = struct.Struct("<Q")  # bytes of the message indexes that follow a chunk
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; then the data
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
    stream: IO[bytes],
    *,
    on_damage: Callable[[str], None] | None = None,
    skip: Mapping[int, int] = MappingProxyType({}),
    ignore: Set[str] = frozenset(),
) -> Iterator[McapRecord]:
    """Header, schemas, channels, messages, attachments, metadata, data end and footer, in file
    order; chunks are unpacked.

    Raises LogError where the stream is no MCAP, is cut off or altered; what was yielded before is
    sound. With `on_damage`, a record whose contents are damaged is reported there and skipped,
    and only the loss of the records' boundaries raises. `skip`: places to leave unread,
    offset -> bytes; the checksum of the data section is then not compared. `ignore`: topics whose
    messages are left out.
    """
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise LogError("not an MCAP file: it does not start as one")
    checksum = zlib.crc32(MCAP0_MAGIC)  # of the data section, then of the summary
    at = len(MCAP0_MAGIC)
    ignored: set[int] = set()  # channels
    opcode = 0
    while opcode != Opcode.FOOTER:
        if at in skip:
            stream.seek(skip[at], io.SEEK_CUR)
            at += skip[at]
            continue
        try:
            opcode, head, body = _read_frame(stream)
        except _Broken as error:
            raise LogError(f"damaged at byte {at}: {error}") from error
        try:
            for record in _contents(opcode, body, ignored):
                if isinstance(record, Channel) and record.topic in ignore:
                    ignored.add(record.id)
                yield record
            if opcode == Opcode.DATA_END:
                _compare(0 if skip else _checksum(body), checksum, "data section")
            elif opcode == Opcode.FOOTER:
                _compare(_checksum(body), zlib.crc32(head + body[:-4], checksum), "summary")
        except _UNREADABLE as error:
            problem = f"damaged at byte {at}: {str(error) or type(error).__name__}"
            if on_damage is None:
                raise LogError(problem) from error
            on_damage(problem)
        checksum = zlib.crc32(body, zlib.crc32(head, checksum))
        if opcode == Opcode.DATA_END:
            checksum = 0
        at += len(head) + len(body)
    if stream.read(len(MCAP0_MAGIC) + 1) != MCAP0_MAGIC:
        raise LogError("the file does not end as an MCAP file does: cut off, or something follows")


class _Broken(Exception):
    """The bytes contradict themselves, or are missing."""


_UNREADABLE = (_Broken, McapError, struct.error, ValueError, OverflowError, zstandard.ZstdError)


def chunks_of(stream: IO[bytes], topics: Set[str]) -> dict[int, int]:
    """Chunks that hold nothing but messages on `topics`, as the summary has it: offset -> bytes,
    with the message indexes that follow. None if there is no sound summary. The first chunk, which
    declares the channels, is never among them. The stream must be able to seek; its place is lost.
    """
    channels: dict[int, str] = {}
    chunks: list[tuple[int, int, list[int]]] = []  # offset, bytes, channels
    try:
        stream.seek(-_FOOTER.size - len(MCAP0_MAGIC), io.SEEK_END)
        _, _, summary_start, _, _ = _FOOTER.unpack(stream.read(_FOOTER.size))
        stream.seek(summary_start)
        while True:
            opcode, _, body = _read_frame(stream)
            if opcode == Opcode.CHANNEL:
                declared = Channel.read(ReadDataStream(io.BytesIO(body)))
                channels[declared.id] = declared.topic
            elif opcode == Opcode.CHUNK_INDEX:
                _, _, offset, size, length = _CHUNK_INDEX.unpack_from(body)
                held = _INDEX_OFFSET.iter_unpack(body[_CHUNK_INDEX.size :][:length])
                size += _LENGTH.unpack_from(body, _CHUNK_INDEX.size + length)[0]
                if not 0 < size <= summary_start - offset:
                    raise _Broken(f"a chunk of {size} bytes at {offset}")
                chunks.append((offset, size, [channel for channel, _ in held]))
            elif opcode == Opcode.FOOTER:
                break
    except (OSError, *_UNREADABLE):
        return {}
    return {
        offset: size
        for offset, size, held in sorted(chunks)[1:]
        if held and all(channels.get(channel, "") in topics for channel in held)
    }


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


def _contents(opcode: int, body: bytes, ignored: Set[int]) -> Iterator[McapRecord]:
    """The record, or those within it if it is a chunk; nothing if it is of a kind that is new."""
    if opcode == Opcode.ATTACHMENT:
        _compare(_checksum(body), zlib.crc32(body[:-4]), "attachment")
    if opcode == Opcode.MESSAGE:
        if len(body) < _MESSAGE.size:
            raise _Broken(f"a message of {len(body)} bytes")
        channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
        if channel not in ignored:
            yield Message(channel, log_time, body[_MESSAGE.size :], publish_time, sequence)
    elif opcode in _PARSERS:
        record = _PARSERS[opcode].read(ReadDataStream(io.BytesIO(body)))
        if isinstance(record, Chunk):
            yield from _unpack(record, ignored)
        else:
            yield record


def _unpack(chunk: Chunk, ignored: Set[int]) -> Iterator[McapRecord]:
    """What a chunk holds. Most of it is states of the arm, which an audit passes over: this loop
    sets the audit's pace."""
    data = _decompress(chunk)
    _compare(chunk.uncompressed_crc, zlib.crc32(data), "chunk")
    at, end = 0, len(data)
    while at < end:
        body = at + _HEAD.size
        if body > end:
            raise _Broken("cut off within a chunk")
        opcode, length = _HEAD.unpack_from(data, at)
        at = body + length
        if at > end:
            raise _Broken(f"cut off within a record of {length} bytes, after {end - body}")
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise _Broken(f"a message of {length} bytes")
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, body)
            if channel not in ignored:
                content = data[body + _MESSAGE.size : at]
                yield Message(channel, log_time, content, publish_time, sequence)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):  # nothing else belongs here
            yield from _contents(opcode, data[body:at], ignored)


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
        raise _Broken(f"a chunk compressed with {chunk.compression!r:.40}; only zstd is read")
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
