"""Files that nobody should trust: a clear LogError, never a traceback, never endless memory.

TDPG_FUZZ=10000 pytest tests/tdpg_deploy/episode_log/test_log_damage.py   tries that many.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Chunk, Message, Metadata
from mcap.writer import MCAP0_MAGIC, Writer
from rewritten_log import rewrite
from synthetic_episode import Synthetic, write

from tdpg_deploy.episode_log import about
from tdpg_deploy.episode_log.channels import IMAGES
from tdpg_deploy.episode_log.entries import Step
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.episode_log.records import LIMIT, chunks_of, read_records
from tdpg_deploy.episode_log.recover import Condition, check, recover
from tdpg_deploy.errors import LogError

MUTATIONS = int(os.environ.get("TDPG_FUZZ", "150"))
BATCHES = 10


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "episode.mcap"
    synthetic = Synthetic()
    write(path, synthetic.episode(2, states=2), now=synthetic.now)
    return path


def read_all(path: Path) -> int:
    """How many entries come before the end, or before a LogError."""
    count = 0
    with contextlib.suppress(LogError):
        for _ in read_episode(path).entries():
            count += 1
    return count


def read_quickly(path: Path) -> list[Step]:
    steps: list[Step] = []
    with contextlib.suppress(LogError):
        steps.extend(read_episode(path).steps(images=False, states=False))
    return steps


# --- mutations --------------------------------------------------------------------------------


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """One of the things that disks, networks and people do to files."""
    at = int(rng.integers(len(data)))
    length = int(rng.integers(1, 2000))
    noise = rng.bytes(int(rng.integers(1, 12)))
    changed = bytearray(data)
    match rng.integers(6):
        case 0:
            changed[at] ^= 1 << int(rng.integers(8))
        case 1:
            changed[at : at + len(noise)] = noise
        case 2:
            del changed[at:]
        case 3:
            del changed[at : at + length]
        case 4:
            changed[at:at] = changed[at : at + length]
        case _:
            changed[at : at + 8] = b"\xff" * 8
    return bytes(changed)


@pytest.mark.parametrize("batch", range(BATCHES))
def test_mutated_files(whole: Path, tmp_path: Path, batch: int) -> None:
    data = whole.read_bytes()
    for number in range(batch, MUTATIONS, BATCHES):
        rng = np.random.default_rng(number)
        path, saved = tmp_path / f"{number}.mcap", tmp_path / f"{number}.saved.mcap"
        change = mutate if number % 2 else mutate_structure  # chunks of images fill the file
        path.write_bytes(change(data, rng))
        read_all(path)
        read_quickly(path)
        report = recover(path, saved)
        assert saved.exists() == (report.condition is not Condition.NOTHING)
        if saved.exists():
            assert sum(1 for r in read_strictly(saved) if isinstance(r, Message)) == report.messages
            saved.unlink()
        path.unlink()


def mutate_structure(data: bytes, rng: np.random.Generator) -> bytes:
    """Overwrite bytes in the head of one record."""
    heads = []
    at = len(MCAP0_MAGIC)
    while at + 9 < len(data):
        heads.append(at)
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    at = heads[int(rng.integers(len(heads)))] + int(rng.integers(0, 60))
    noise = rng.bytes(int(rng.integers(1, 9)))
    return data[:at] + noise + data[at + len(noise) :]


def read_strictly(path: Path) -> list[object]:
    with path.open("rb") as file:
        return list(read_records(file))


@pytest.mark.parametrize("batch", range(BATCHES))
def test_hostile_contents_in_a_sound_file(whole: Path, tmp_path: Path, batch: int) -> None:
    """Every checksum is right; what lies in messages, metadata or attachments is not."""
    for number in range(batch, MUTATIONS // 3, BATCHES):
        rng = np.random.default_rng(number)
        path = tmp_path / f"{number}.mcap"
        with whole.open("rb") as source, path.open("wb") as file:
            rewrite(source, file, partial(sometimes_mutate, rng=rng))
        read_all(path)
        check(path)
        path.unlink()


def sometimes_mutate(_: str, data: bytes, rng: np.random.Generator) -> bytes:
    return mutate(data, rng) if rng.random() < 0.1 else data


# --- what each kind of damage is called -------------------------------------------------------


def test_a_sound_file_is_whole(whole: Path) -> None:
    report = check(whole)
    assert report.condition is Condition.WHOLE
    assert report.damage == ()
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert report.messages == summary.statistics.message_count


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"#ROSBAG V2.0\n", b"\0" * 5000])
def test_foreign_files(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"other\.mcap: not an MCAP file"):
        read_episode(path)
    assert check(path).condition is Condition.NOTHING


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"nowhere.mcap: cannot be read \(No such file"):
        read_episode(tmp_path / "nowhere.mcap")
    assert check(tmp_path / "nowhere.mcap").condition is Condition.NOTHING


def test_an_mcap_of_somebody_else(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("robot", {"name": "Marvin"})
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(LogError, match="not the log of an episode"):
        read_episode(path)


def test_a_log_of_the_future(tmp_path: Path) -> None:
    path = tmp_path / "future.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata(about.METADATA, {"schema_version": "99"})
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(LogError, match=r"schema 99 is newer than 1.*update tdpg-deploy"):
        read_episode(path)


def test_a_flipped_bit_in_an_image_is_found_and_only_that_is_lost(
    whole: Path, tmp_path: Path
) -> None:
    data = bytearray(whole.read_bytes())
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    hurt = max(summary.chunk_indexes, key=lambda chunk: chunk.compressed_size)
    data[hurt.chunk_start_offset + hurt.chunk_length // 2] ^= 4
    path, saved = tmp_path / "flipped.mcap", tmp_path / "saved.mcap"
    path.write_bytes(data)
    with pytest.raises(LogError, match=f"damaged at byte {hurt.chunk_start_offset}"):
        list(read_episode(path).entries())
    report = recover(path, saved)
    assert report.condition is Condition.LOSSY
    lost = len(hurt.message_index_offsets)
    assert report.messages == check(whole).messages - lost
    assert check(saved).condition is Condition.WHOLE
    assert read_all(saved) == read_all(whole) - 1  # the look that held the image


def test_a_hurt_image_does_not_matter_to_whom_reads_none(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    with whole.open("rb") as file:
        hurt = max(chunks_of(file, IMAGES))
    data[hurt + 500] ^= 4
    path = tmp_path / "flipped.mcap"
    path.write_bytes(data)
    steps = list(read_episode(path).steps(images=False))
    assert len(steps) == 2
    assert steps[-1].outcome is not None


def test_without_a_summary_all_chunks_are_read(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[:-1])
    with path.open("rb") as file:
        assert chunks_of(file, IMAGES) == {}
    assert len(read_quickly(path)) == 2


def test_a_flipped_bit_in_the_metadata_is_found(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    at = data.index(b"tdpg-run --objects 10")
    path = tmp_path / "flipped.mcap"
    path.write_bytes(data[:at] + b"T" + data[at + 1 :])
    assert "checksum of the data section differs" in check(path).damage[0]


def test_a_cut_file_keeps_what_lies_before(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    path, saved = tmp_path / "cut.mcap", tmp_path / "saved.mcap"
    path.write_bytes(data[: len(data) * 2 // 3])
    assert recover(path, saved).condition is Condition.LOSSY
    assert read_all(saved) == read_all(path) > 5
    with saved.open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) > 20


def test_nothing_is_saved_of_nothing(tmp_path: Path) -> None:
    path, saved = tmp_path / "empty.mcap", tmp_path / "saved.mcap"
    path.write_bytes(MCAP0_MAGIC)
    report = recover(path, saved)
    assert report.condition is Condition.NOTHING
    assert list(tmp_path.iterdir()) == [path]


def test_recover_never_overwrites(whole: Path, tmp_path: Path) -> None:
    target = tmp_path / "precious.mcap"
    target.write_bytes(b"precious")
    with pytest.raises(LogError, match="exists already"):
        recover(whole, target)
    assert target.read_bytes() == b"precious"


# --- memory -----------------------------------------------------------------------------------


def framed(opcode: int, body: bytes, length: int | None = None) -> io.BytesIO:
    head = struct.pack("<BQ", opcode, len(body) if length is None else length)
    return io.BytesIO(MCAP0_MAGIC + head + body)


@pytest.mark.parametrize("length", [LIMIT + 1, 2**40, 2**63, 2**64 - 1])
def test_a_record_without_end(length: int) -> None:
    with pytest.raises(LogError, match=rf"a record of {length} bytes; at most"):
        list(read_records(framed(Opcode.CHUNK, b"", length)))


def bomb(*, claimed: int, knows_its_size: bool) -> bytes:
    """The body of a chunk of a few kilobytes that unpacks to more than LIMIT."""
    compressor = zstandard.ZstdCompressor(write_content_size=knows_its_size)
    data = compressor.compress(b"\0" * (LIMIT + 1))
    head = struct.pack("<QQQI", 0, 0, claimed, 0) + struct.pack("<I", 4) + b"zstd"
    return head + struct.pack("<Q", len(data)) + data


@pytest.mark.parametrize(
    ("claimed", "knows_its_size", "reason"),
    [
        (LIMIT + 1, True, "at most"),
        (100, True, "larger than it says"),
        (100, False, "damaged at byte 8"),
    ],
)
def test_a_chunk_that_unpacks_without_end(claimed: int, knows_its_size: bool, reason: str) -> None:
    body = bomb(claimed=claimed, knows_its_size=knows_its_size)
    assert len(body) < 100_000
    with pytest.raises(LogError, match=reason):
        list(read_records(framed(Opcode.CHUNK, body)))


@pytest.mark.parametrize("length", [2**40, 2**63, 2**64 - 1])
def test_a_chunk_whose_data_have_no_end(length: int) -> None:
    body = struct.pack("<QQQI", 0, 0, 100, 0) + struct.pack("<I", 4) + b"zstd"
    with pytest.raises(LogError, match="damaged at byte 8"):
        list(read_records(framed(Opcode.CHUNK, body + struct.pack("<Q", length) + b"data")))


@pytest.mark.parametrize("opcode", [Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA])
def test_a_chunk_holds_messages_only(opcode: int) -> None:
    """Anything else could unpack to any size, again and again."""
    inner = struct.pack("<BQ", opcode, 4) + b"data"
    head = struct.pack("<QQQI", 0, 0, len(inner), 0) + struct.pack("<I", 0)
    body = head + struct.pack("<Q", len(inner)) + inner
    with pytest.raises(LogError, match="cut off"):  # after the chunk, not within it
        assert list(read_records(framed(Opcode.CHUNK, body))) == []


def test_a_message_that_is_too_short() -> None:
    with pytest.raises(LogError, match="a message of 5 bytes"):
        list(read_records(framed(Opcode.MESSAGE, b"12345")))


def test_unknown_records_are_skipped() -> None:
    with pytest.raises(LogError, match="cut off"):
        list(read_records(framed(0x7F, b"from the future")))


def test_types_of_records(whole: Path) -> None:
    kinds = {type(record) for record in read_strictly(whole)}
    assert {Message, Metadata, Attachment} <= kinds
    assert Chunk not in kinds
