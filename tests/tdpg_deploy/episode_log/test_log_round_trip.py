"""What is written is what is read, and an independent reader sees the same."""

from __future__ import annotations

import contextlib
import json
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from synthetic_episode import ABOUT, Call, Synthetic, small_disk, write

from tdpg_deploy.episode_log import channels
from tdpg_deploy.episode_log.about import CELL, LAYOUT, METADATA, RESULT, SCENE, VERSIONS
from tdpg_deploy.episode_log.entries import (
    Conclusion,
    End,
    Entry,
    Intent,
    LoggedDecision,
    Look,
    QPictures,
    Refusal,
)
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.episode_log.writer import EpisodeWriter
from tdpg_deploy.episode_record import EpisodeRecorder, EpisodeResult
from tdpg_deploy.errors import LogError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Intrinsics
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.workspace import workspace_of


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Call]]:
    """A log that is whole, and the calls that made it. Not to be altered."""
    synthetic = Synthetic()
    calls = synthetic.episode()
    path = tmp_path_factory.mktemp("log") / "episode.mcap"
    write(path, calls, now=synthetic.now)
    return path, calls


def same(a: Any, b: Any) -> bool:
    """Equal to the last bit, nan equal to nan; poses to rounding of their quaternion."""
    if isinstance(a, Transform):
        return type(b) is Transform and bool(np.allclose(a.as_matrix(), b.as_matrix(), 0, 1e-15))
    if isinstance(a, np.ndarray):
        return bool(a.dtype == b.dtype and a.shape == b.shape) and a.tobytes() == b.tobytes()
    if is_dataclass(a):
        return type(a) is type(b) and all(
            same(getattr(a, field.name), getattr(b, field.name)) for field in fields(a)
        )
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float):
        return bool(a == b or (np.isnan(a) and np.isnan(b)))
    return bool(a == b) and (not isinstance(a, Enum) or a is b)


def expected(call: Call) -> Entry:
    """The entry that a recorder's call should become."""
    one, *more = call.arguments
    stamp: Any = call.stamp
    entries: dict[str, Any] = {
        "observe": lambda: Look(frame=one, heightmap=more[0]),
        "refused": lambda: Refusal(
            decision=LoggedDecision.of(one), reason=more[0], stamp=stamp
        ),
        "intend": lambda: Intent(decision=LoggedDecision.of(one), plan=more[0], stamp=stamp),
        "arm_state": lambda: one,
        "gripper_state": lambda: one,
        "conclude": lambda: Conclusion(outcome=one, stamp=stamp),
        "end": lambda: End(result=one, stamp=stamp),
    }  # fmt: skip
    entry: Entry = entries[call.name]()
    return entry


@pytest.mark.parametrize("goal", [False, True])
def test_every_call_comes_back(tmp_path: Path, goal: bool) -> None:
    synthetic = Synthetic(seed=3)
    calls = synthetic.episode(2, goal=goal)
    path = tmp_path / "episode.mcap"
    write(path, calls, now=synthetic.now)
    episode = read_episode(path)
    assert episode.about == ABOUT
    entries = list(episode.entries())
    shown = [entry for entry in entries if isinstance(entry, QPictures)]
    assert len(shown) == 2
    assert {picture.push.shape for picture in shown} == {(448, 448, 3)}
    entries = [entry for entry in entries if not isinstance(entry, QPictures)]
    assert len(entries) == len(calls)
    for entry, call in zip(entries, calls, strict=True):
        assert same(entry, expected(call)), call.name


def test_entries_without_images_or_states_are_the_others(
    logged: tuple[Path, list[Call]],
) -> None:
    path, calls = logged
    others = [without_images(expected(call)) for call in calls]
    assert same(list(read_episode(path).entries(images=False)), others)
    told = [without_images(expected(call)) for call in calls if not call.name.endswith("_state")]
    assert same(list(read_episode(path).entries(images=False, states=False)), told)


def without_images(entry: Entry) -> Entry:
    return entry.document if isinstance(entry, Look) else entry


def test_steps_group_what_belongs_together(logged: tuple[Path, list[Call]]) -> None:
    path, calls = logged
    steps = list(read_episode(path).steps())
    looks = [expected(call) for call in calls if call.name == "observe"]
    assert [len(step.refusals) for step in steps] == [0, 1, 0]
    moved = [call.arguments[0] for call in calls if call.name == "arm_state"]
    points = [point for step in steps for point in step.tool_path]
    assert [len(step.tool_path) for step in steps] == [4, 4, 4]
    assert [point.stamp for point in points] == [state.stamp for state in moved]
    for point, state in zip(points, moved, strict=True):
        assert point.p_base == tuple(state.X_base_tool.translation)
        assert point.force == pytest.approx(np.linalg.norm(state.force))
    assert [len(step.gripper_states) for step in steps] == [1, 1, 1]
    outcomes = [call.arguments[0] for call in calls if call.name == "conclude"]
    assert same([step.outcome for step in steps], outcomes)
    for i, step in enumerate(steps):
        assert same(step.look, looks[i])
        assert same(step.next_look, looks[i + 1])


def test_refusals_that_end_an_episode_are_a_step(tmp_path: Path) -> None:
    synthetic = Synthetic()
    path = tmp_path / "episode.mcap"
    blocks = synthetic.blocks(2)
    with EpisodeWriter(path, ABOUT, now=synthetic.now) as writer:
        writer.observe(synthetic.frame(), synthetic.heightmap(blocks))
        writer.refused(synthetic.decision(blocks, push=False), "out of reach", stamp=6.0)
    [step] = read_episode(path).steps()
    assert step.intent is None
    assert [refusal.reason for refusal in step.refusals] == ["out of reach"]


def test_an_interrupted_action_is_a_step_without_outcome(tmp_path: Path) -> None:
    path = tmp_path / "episode.mcap"
    synthetic = Synthetic()
    write(path, synthetic.episode(1)[:4], now=synthetic.now)
    [step] = read_episode(path).steps()
    assert step.intent is not None
    assert step.outcome is None
    assert len(step.tool_path) == 2


# --- as the mcap package reads it -------------------------------------------------------------


def test_foreign_reader_decodes_every_message(logged: tuple[Path, list[Call]]) -> None:
    path, calls = logged
    counts: dict[str, int] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            assert schema is not None
            if schema.encoding == "jsonschema":
                json.loads(message.data, parse_constant=pytest.fail)  # nan is not JSON
                json.loads(schema.data)
        for item in reader.iter_decoded_messages([*channels.PROTOBUF]):
            assert item.schema is not None
            assert item.decoded_message.DESCRIPTOR.full_name == item.schema.name
    made = {name: sum(call.name == name for call in calls) for name in {c.name for c in calls}}
    assert set(counts) == {*channels.PROTOBUF, *channels.DOCUMENTS}
    for topic in channels.IMAGES - {channels.Q_PUSH, channels.Q_GRASP}:
        assert counts[topic] == made["observe"]
    assert counts[channels.TRANSFORMS] == made["observe"] + made["arm_state"]
    assert counts[channels.DECISION] == counts[channels.Q_PUSH] == made["intend"]
    assert counts[channels.REFUSAL] == made["refused"]
    assert counts[channels.RESULT] == 1


def test_topics_have_slashes_and_no_dots() -> None:
    for topic in [*channels.PROTOBUF, *channels.DOCUMENTS]:
        assert topic.startswith("/")
        assert "." not in topic


def test_metadata_and_attachments_precede_the_messages(logged: tuple[Path, list[Call]]) -> None:
    path, _ = logged
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        first_chunk = min(chunk.chunk_start_offset for chunk in summary.chunk_indexes)
        attachments = {index.name: index.offset for index in summary.attachment_indexes}
        metadata = {index.name: index.offset for index in summary.metadata_indexes}
        assert attachments.keys() == {CELL, LAYOUT, SCENE}
        assert max(attachments.values()) < first_chunk
        assert max(metadata[METADATA], metadata[VERSIONS]) < first_chunk
        content = {record.name: record.metadata for record in reader.iter_metadata()}
    assert content[METADATA]["seed"] == "7"
    assert content[METADATA]["checkpoint_sha256"] == ABOUT.checkpoint_sha256
    assert content[VERSIONS] == ABOUT.versions
    assert content[RESULT]["reason"] == "action limit"


def test_images_keep_to_their_own_chunks(logged: tuple[Path, list[Call]]) -> None:
    """An audit of the documents need not unpack them."""
    path, _ = logged
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for chunk in summary.chunk_indexes:
        topics = {summary.channels[number].topic for number in chunk.message_index_offsets}
        assert topics <= channels.IMAGES or not topics & channels.IMAGES


def test_time_starts_on_the_calendar_and_runs_with_the_cell(
    logged: tuple[Path, list[Call]],
) -> None:
    path, calls = logged
    with path.open("rb") as file:
        messages = list(make_reader(file).iter_messages(log_time_order=False))
    times = [message.log_time for _, _, message in messages]
    assert times == sorted(times)
    assert times[0] >= ABOUT.started_at * 1e9
    captured: Any = [call.arguments[0] for call in calls if call.name == "observe"]
    looks = [m.publish_time for _, channel, m in messages if channel.topic == channels.COLOR]
    gaps = np.diff([frame.captured_at for frame in captured])
    np.testing.assert_allclose(np.diff(looks) / 1e9, gaps, atol=2e-9)


# --- what may go wrong while writing ----------------------------------------------------------


def test_what_was_told_survives_the_process(tmp_path: Path) -> None:
    """The bytes that the operating system has after each call are what a kill -9 leaves."""
    synthetic = Synthetic()
    path = tmp_path / "episode.mcap"
    told: list[Entry] = []
    with EpisodeWriter(path, ABOUT, now=synthetic.now) as writer:
        for call in synthetic.episode(2):
            call.make(writer)
            told.append(expected(call))
            if call.name in {"arm_state", "gripper_state"}:
                continue
            with pytest.raises(LogError, match="cut off"):
                list(read_episode(writer.part).entries())
            assert same(readable(writer.part), told), call.name
            assert not path.exists()
    assert path.exists()
    assert not writer.part.exists()


def readable(path: Path) -> list[Entry]:
    """The entries before the damage, but for pictures."""
    entries: list[Entry] = []
    with contextlib.suppress(LogError):
        entries.extend(read_episode(path).entries())
    return [entry for entry in entries if not isinstance(entry, QPictures)]


def test_full_disk_is_a_log_error_and_what_was_written_stays(tmp_path: Path) -> None:
    synthetic = Synthetic()
    path = tmp_path / "episode.mcap"
    calls = synthetic.episode(4)
    writer = EpisodeWriter(path, ABOUT, now=synthetic.now)
    made = 0

    def write_all() -> None:
        nonlocal made
        with small_disk(1_500_000), writer:
            for call in calls:
                call.make(writer)
                made += 1

    with pytest.raises(LogError, match=r"cannot be written .* stays readable") as caught:
        write_all()
    assert 3 < made < len(calls)
    assert str(writer.part) in str(caught.value)
    assert not path.exists()
    read = readable(writer.part)
    durable = [expected(call) for call in calls[:made]]
    assert len(read) >= made - 6  # states since the last boundary may be lost
    assert same(read, durable[: len(read)])
    with pytest.raises(LogError, match="cannot be written"):
        calls[made].make(writer)


def test_a_log_is_never_overwritten(tmp_path: Path) -> None:
    synthetic = Synthetic()
    path = tmp_path / "episode.mcap"
    path.write_bytes(b"precious")
    with (
        pytest.raises(LogError, match="exists already"),
        EpisodeWriter(path, ABOUT, now=synthetic.now),
    ):
        pass
    assert path.read_bytes() == b"precious"


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    synthetic = Synthetic()
    (tmp_path / "file").write_text("")
    writer = EpisodeWriter(tmp_path / "file" / "episode.mcap", ABOUT, now=synthetic.now)
    with pytest.raises(LogError, match="cannot be created"), writer:
        pass


def test_it_is_an_episode_recorder(tmp_path: Path) -> None:
    synthetic = Synthetic()
    recorder: EpisodeRecorder = EpisodeWriter(tmp_path / "e.mcap", ABOUT, now=synthetic.now)
    assert recorder


def test_results_without_truth_or_error(tmp_path: Path) -> None:
    synthetic = Synthetic()
    path = tmp_path / "episode.mcap"
    result = synthetic.episode(1)[-1].arguments[0]
    assert isinstance(result, EpisodeResult)
    bare = replace(result, truth=None, error="gripper: not activated")
    with EpisodeWriter(path, ABOUT, now=synthetic.now) as writer:
        writer.end(bare, stamp=9.5)
    assert list(read_episode(path).entries()) == [End(result=bare, stamp=9.5)]


@pytest.mark.parametrize("in_millimetres", [True, False])
def test_the_logged_frame_makes_the_logged_heightmap_again(
    tmp_path: Path, in_millimetres: bool
) -> None:
    """To the last bit, with the camera's pose from the log's own head."""
    synthetic = Synthetic()
    depth = synthetic.rng.uniform(0.5, 0.9, (720, 1280)).astype(np.float32)
    if in_millimetres:
        depth = np.round(depth * 1000).astype(np.float32) * np.float32(0.001)
    frame = replace(
        synthetic.frame(width=1280, height=720),
        depth=depth,
        intrinsics=Intrinsics(width=1280, height=720, fx=920.0, fy=920.0, cx=639.5, cy=359.5),
    )
    workspace = workspace_of(ABOUT.cell)
    heightmap = build_heightmap(frame, ABOUT.cell.X_base_camera, workspace)
    assert heightmap.valid.any()
    path = tmp_path / "episode.mcap"
    write(path, [Call(name="observe", arguments=(frame, heightmap))], now=synthetic.now)
    episode = read_episode(path)
    [look] = episode.entries()
    assert isinstance(look, Look)
    cell = episode.about.cell
    assert same(build_heightmap(look.frame, cell.X_base_camera, workspace_of(cell)), heightmap)
    assert same(look.heightmap, heightmap)
