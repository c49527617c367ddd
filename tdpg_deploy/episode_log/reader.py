"""Read an episode back: entries as they happened, or the steps that they make up. Lazily."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Set
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TypeAlias

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata

from tdpg_deploy.episode_log import channels, documents, messages
from tdpg_deploy.episode_log.about import METADATA, VERSIONS, About, from_metadata
from tdpg_deploy.episode_log.entries import (
    End,
    Entry,
    ForceDocument,
    ForceNorm,
    Intent,
    LoggedDecision,
    Look,
    LookDocument,
    PlanDocument,
    QPictures,
    Step,
    ToolPoint,
)
from tdpg_deploy.episode_log.grouping import group
from tdpg_deploy.episode_log.records import chunks_of, read_records
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import LogError
from tdpg_deploy.hal import ArmState, RgbdFrame


@dataclass(frozen=True, kw_only=True)
class Episode:
    """A log whose head has been read. `entries` and `steps` read the file anew at each call and
    hold one step in memory. At damage they raise LogError, after all that lies before it."""

    path: Path
    about: About

    def entries(self, *, images: bool = True, states: bool = True) -> Iterator[Entry]:
        """Everything, in order. Without `images` they stay unread and unchecked, which is many
        times faster, and a LookDocument stands for each look; without `states` those of arm and
        gripper are left out."""
        return self._entries(_FOR_VIEWERS if states else _FOR_VIEWERS | _STATES, _CLOSING, images)

    def steps(self, *, images: bool = True, states: bool = True) -> Iterator[Step]:
        """One for each planned action, and a last one for refusals that led to none. Of the arm's
        states they hold ToolPoints."""
        ignore = _FOR_VIEWERS | {channels.JOINTS} if states else _FOR_VIEWERS | _STATES
        return group(self._entries(ignore, _CLOSING_OF_STEPS, images))

    def _entries(self, ignore: Set[str], closing: _Closing, images: bool) -> Iterator[Entry]:
        if images:
            return _entries(self.records(ignore=ignore), closing)
        unread = ignore | channels.IMAGES
        return _entries(self.records(ignore=unread, unread=unread), closing | _WITHOUT_IMAGES)

    def raw(self, topics: Set[str]) -> Iterator[tuple[str, bytes]]:
        """Topic and content of the messages on these topics, in order, not decoded.
        Raises LogError."""
        others = (channels.PROTOBUF.keys() | channels.DOCUMENTS.keys()) - topics
        names: dict[int, str] = {}
        for record in self.records(ignore=others, unread=others):
            if isinstance(record, Channel):
                names[record.id] = record.topic
            elif isinstance(record, Message) and names.get(record.channel_id) in topics:
                yield names[record.channel_id], record.data

    def records(
        self, *, ignore: Set[str] = frozenset(), unread: Set[str] = frozenset()
    ) -> Iterator[McapRecord]:
        """Without messages on topics to ignore, and without chunks of nothing but `unread`.
        Raises LogError at damage, after all that lies before it."""
        try:
            with self.path.open("rb") as file:
                skip = chunks_of(file, unread) if unread else {}
                file.seek(0)
                yield from read_records(file, skip=skip, ignore=ignore)
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read ({error.strerror})") from error
        except LogError as error:
            raise LogError(f"{self.path}: {error}") from error

    def result(self) -> EpisodeResult | None:
        """How the episode went; None if the log ends before that was told."""
        result = None
        with contextlib.suppress(LogError):
            for entry in self.entries(images=False, states=False):
                if isinstance(entry, End):
                    result = entry.result
        return result


def read_episode(path: Path) -> Episode:
    """Read the head of a log. Raises LogError for anything that is not an episode's log."""
    try:
        with path.open("rb") as file:
            return Episode(path=path, about=_read_head(read_records(file)))
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    except LogError as error:
        raise LogError(f"{path}: {error}") from error


def _read_head(records: Iterator[McapRecord]) -> About:
    metadata: dict[str, dict[str, str]] = {}
    attachments: dict[str, bytes] = {}
    try:
        for record in records:
            if isinstance(record, Metadata):
                metadata[record.name] = record.metadata
            elif isinstance(record, Attachment):
                attachments[record.name] = record.data
            elif isinstance(record, Message):
                break
    except LogError:
        if METADATA not in metadata:
            raise
    if METADATA not in metadata:
        raise LogError("an MCAP file, but not the log of an episode: it has no tdpg metadata")
    return from_metadata(metadata[METADATA], metadata.get(VERSIONS, {}), attachments)


def _entries(records: Iterator[McapRecord], closing: _Closing) -> Iterator[Entry]:
    topics: dict[int, str] = {}
    parts = _Parts()
    for record in records:
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            topic = topics.get(record.channel_id, "")
            if topic in _ALONE:
                yield documents.decode(channels.DOCUMENTS[topic], record.data)
            elif topic in closing:
                entry = closing[topic](parts, record)
                if entry is not None:
                    yield entry
            else:
                parts.keep(topic, record)


class _Parts:
    """The last message of every topic that waits for the document that closes its entry."""

    def __init__(self) -> None:
        self._messages: dict[str, Message] = {}

    def keep(self, topic: str, message: Message) -> None:
        self._messages[topic] = message

    def take(self, closing: Message, *topics: str) -> list[bytes] | None:
        """Their data, or None if one was lost, as in the middle of a recovered file."""
        messages = [self._messages.pop(topic, None) for topic in topics]
        whole = [m.data for m in messages if m and m.publish_time == closing.publish_time]
        return whole if len(whole) == len(topics) else None


def _look_document(closing: Message) -> LookDocument:
    return documents.decode(LookDocument, closing.data)


def _look(parts: _Parts, closing: Message) -> Look | None:
    document = _look_document(closing)
    data = parts.take(
        closing, channels.COLOR, channels.DEPTH, channels.CALIBRATION, channels.HEIGHTMAP
    )
    if data is None:
        return None
    color, depth, calibration, heightmap = data
    rim = parts.take(closing, channels.HEIGHTMAP_RIM)  # not in the first logs
    frame = RgbdFrame(
        color=messages.decode_picture(messages.parse(CompressedImage, color)),
        depth=messages.decode_depth(messages.parse(RawImage, depth)),
        intrinsics=messages.decode_calibration(messages.parse(CameraCalibration, calibration)),
        captured_at=document.captured_at,
        sequence=document.sequence,
        serial=document.serial,
    )
    return Look(
        frame=frame,
        heightmap=messages.decode_heightmap(
            messages.parse(Grid, heightmap), None if rim is None else messages.parse(Grid, rim[0])
        ),
    )


def _q_pictures(parts: _Parts, closing: Message) -> QPictures | None:
    data = parts.take(closing, channels.Q_PUSH)
    if data is None:
        return None
    push, grasp = (
        messages.decode_picture(messages.parse(CompressedImage, png))
        for png in (data[0], closing.data)
    )
    return QPictures(push=push, grasp=grasp)


def _intent(parts: _Parts, closing: Message) -> Intent | None:
    document = documents.decode(PlanDocument, closing.data)
    data = parts.take(closing, channels.DECISION)
    if data is None:
        return None
    decision = documents.decode(LoggedDecision, data[0])
    return Intent(decision=decision, plan=document.plan, stamp=document.stamp)


def _arm_state(parts: _Parts, closing: Message) -> ArmState | None:
    document = documents.decode(ForceDocument, closing.data)
    data = parts.take(closing, channels.JOINTS, channels.TRANSFORMS)
    if data is None:
        return None
    joints, transforms = data
    q, qd = messages.decode_joints(messages.parse(JointStates, joints))
    pose = messages.decode_transform(messages.parse(FrameTransforms, transforms), channels.TOOL)
    if pose is None:
        return None
    force = np.array([document.x, document.y, document.z])
    return ArmState(q=q, qd=qd, X_base_tool=pose, force=force, stamp=document.stamp)


def _tool_point(parts: _Parts, closing: Message) -> ToolPoint | None:
    document = documents.decode(ForceNorm, closing.data)
    data = parts.take(closing, channels.TRANSFORMS)
    if data is None:
        return None
    transforms = messages.parse(FrameTransforms, data[0])
    p_base = messages.decode_translation(transforms, channels.TOOL)
    if p_base is None:
        return None
    if not all(map(isfinite, (*p_base, document.stamp))):
        raise LogError(f"the tool at {p_base} at {document.stamp} s is nowhere")
    return ToolPoint(p_base=p_base, force=document.norm, stamp=document.stamp)


_Closing: TypeAlias = dict[str, Callable[[_Parts, Message], Entry | None]]
_CLOSING: _Closing = {
    channels.LOOK: _look,
    channels.Q_GRASP: _q_pictures,
    channels.PLAN: _intent,
    channels.TOOL_FORCE: _arm_state,
}
_CLOSING_OF_STEPS: _Closing = _CLOSING | {channels.TOOL_FORCE: _tool_point}
_WITHOUT_IMAGES: _Closing = {channels.LOOK: lambda _, closing: _look_document(closing)}
_STATES = frozenset({channels.JOINTS, channels.TRANSFORMS, channels.TOOL_FORCE, channels.GRIPPER})
_FOR_VIEWERS = frozenset({channels.LOG_LINES, channels.PLAN_SCENE, channels.PLAN_POSES})
_ALONE = channels.DOCUMENTS.keys() - _CLOSING.keys() - {channels.DECISION}
