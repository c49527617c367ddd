"""Write one episode as one MCAP file, while it happens.

The file is called .part until it is closed. Every chunk holds pictures, measured images or
documents, so that an audit of the documents never unpacks an image. What an EpisodeRecorder has
been told survives the death of the process once `observe`, `refused`, `intend` or `conclude` has
returned.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from importlib.resources import files
from math import hypot
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from google.protobuf.message import Message
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from policies.heightmap import Heightmap
from policies.policy import Decision
from tdpg_deploy import __version__
from tdpg_deploy.episode_log import about as head
from tdpg_deploy.episode_log import channels, documents, messages, pictures, plan_scene
from tdpg_deploy.episode_log.entries import (
    Conclusion,
    End,
    ForceDocument,
    LoggedDecision,
    LookDocument,
    PlanDocument,
    Refusal,
)
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import LogError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import ArmState, GripperState, RgbdFrame
from tdpg_deploy.outcome import Outcome
from tdpg_deploy.plan import Plan


class EpisodeWriter:
    """An EpisodeRecorder that writes an MCAP file.

    now: the cell's clock in seconds. Its first reading is laid on `about.started_at`, so that a
    simulated episode plays in the robot's time and yet on the calendar.
    """

    def __init__(self, path: Path, about: head.About, *, now: Callable[[], float]) -> None:
        self.path = path
        self.part = path.with_name(path.name + ".part")
        self._about = about
        self._now = now
        self._file: IO[bytes]
        self._mcap: Writer
        self._offset = 0
        self._channels: dict[str, int] = {}
        self._heightmap: Heightmap | None = None
        self._chunk = ""
        self._step = 0
        self._failure: str | None = None

    def __enter__(self) -> EpisodeWriter:
        if self.path.exists():
            raise LogError(f"{self.path}: exists already, and a log is never overwritten")
        self._offset = messages.nanoseconds(self._about.started_at)
        self._offset -= messages.nanoseconds(self._now())
        try:
            self.part.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.part.open("xb")
        except OSError as error:
            raise LogError(f"{self.part}: cannot be created ({error.strerror})") from error
        with self._guard():
            self._mcap = Writer(self._file, enable_data_crcs=True)
            self._start()
            self._flush()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Complete the file and give it its name. A failed one stays .part, and readable."""
        if self._failure is not None:
            return
        with self._guard():
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self.part.replace(self.path)

    # --- EpisodeRecorder ----------------------------------------------------------------------

    def observe(self, frame: RgbdFrame, heightmap: Heightmap) -> None:
        time = self._time(frame.captured_at)
        look = LookDocument(
            sequence=frame.sequence, serial=frame.serial, captured_at=frame.captured_at
        )
        with self._guard():
            X_base_camera = self._about.cell.X_base_camera
            for topic, message in _look(frame, heightmap, X_base_camera, time).items():
                self._protobuf(topic, message, time)
            self._document(channels.LOOK, look, time)
            self._flush()
        self._heightmap = heightmap

    def refused(self, decision: Decision, reason: str, *, stamp: float) -> None:
        time = self._time(stamp)
        refusal = Refusal(decision=LoggedDecision.of(decision), reason=reason, stamp=stamp)
        with self._guard():
            self._document(channels.REFUSAL, refusal, time)
            self._line(f"refused: {reason}", time, warning=True)
            self._flush()

    def intend(self, decision: Decision, plan: Plan, *, stamp: float) -> None:
        time = self._time(stamp)
        self._step += 1
        kind = type(decision.primitive).__name__.lower()
        with self._guard():
            if self._heightmap is not None:
                for topic, picture in pictures.q_maps(self._heightmap, decision).items():
                    self._protobuf(
                        topic, messages.encode_picture(picture, time, channels.MAP), time
                    )
            self._document(channels.DECISION, LoggedDecision.of(decision), time)
            self._document(channels.PLAN, PlanDocument(plan=plan, stamp=stamp), time)
            self._protobuf(channels.PLAN_SCENE, plan_scene.scene(plan, decision.q, time), time)
            self._protobuf(channels.PLAN_POSES, plan_scene.poses(plan, time), time)
            self._line(f"action {self._step}: {kind}, q = {decision.q:.3f}", time)
            for note in plan.notes:
                self._line(note, time)
            self._flush()

    def arm_state(self, state: ArmState) -> None:
        time = self._time(state.stamp)
        with self._guard():
            self._protobuf(channels.JOINTS, messages.encode_joints(state.q, state.qd, time), time)
            self._protobuf(
                channels.TRANSFORMS,
                messages.encode_transform(channels.BASE, channels.TOOL, state.X_base_tool, time),
                time,
            )
            x, y, z = state.force.tolist()
            force = ForceDocument(x=x, y=y, z=z, norm=hypot(x, y, z), stamp=state.stamp)
            self._document(channels.TOOL_FORCE, force, time)

    def gripper_state(self, state: GripperState) -> None:
        with self._guard():
            self._document(channels.GRIPPER, state, self._time(state.stamp))

    def conclude(self, outcome: Outcome, *, stamp: float) -> None:
        time = self._time(stamp)
        with self._guard():
            self._document(channels.OUTCOME, Conclusion(outcome=outcome, stamp=stamp), time)
            self._line(f"action {self._step}: success {outcome.success.value}", time)
            self._flush()

    def end(self, result: EpisodeResult, *, stamp: float) -> None:
        time = self._time(stamp)
        with self._guard():
            self._document(channels.RESULT, End(result=result, stamp=stamp), time)
            self._line(f"end: {result.reason.value}", time)
            if result.error is not None:
                self._line(result.error, time, warning=True)
            self._flush()
            self._mcap.add_metadata(head.RESULT, documents.flat(result))
            self._flush()

    # --- below --------------------------------------------------------------------------------

    def _start(self) -> None:
        self._mcap.start(profile="tdpg", library=f"tdpg-deploy {__version__}")
        self._mcap.add_metadata(head.METADATA, head.to_metadata(self._about, self._offset))
        self._mcap.add_metadata(head.VERSIONS, dict(self._about.versions))
        self._attach(head.CELL, "application/json", head.cell_attachment(self._about.cell))
        layout = files("tdpg_deploy") / "episode_log" / "layouts" / "foxglove.json"
        self._attach(head.LAYOUT, "application/json", layout.read_bytes())
        if self._about.scene is not None:
            self._attach(head.SCENE, "text/plain", self._about.scene.encode())
        for topic, message in channels.PROTOBUF.items():
            definition = build_file_descriptor_set(message).SerializeToString()
            name = message.DESCRIPTOR.full_name
            schema = self._mcap.register_schema(name, "protobuf", definition)
            self._channels[topic] = self._mcap.register_channel(topic, "protobuf", schema)
        for topic, kind in channels.DOCUMENTS.items():
            definition = documents.schema(kind)
            schema = self._mcap.register_schema(f"tdpg.{kind.__name__}", "jsonschema", definition)
            self._channels[topic] = self._mcap.register_channel(topic, "json", schema)

    def _attach(self, name: str, media_type: str, data: bytes) -> None:
        time = messages.nanoseconds(self._about.started_at)
        self._mcap.add_attachment(time, time, name, media_type, data)

    def _time(self, stamp: float) -> int:
        """Nanoseconds since the UNIX epoch of a time on the cell's clock."""
        return self._offset + messages.nanoseconds(stamp)

    def _protobuf(self, topic: str, message: Message, time: int) -> None:
        assert isinstance(message, channels.PROTOBUF[topic])
        self._add(topic, message.SerializeToString(), time)

    def _document(self, topic: str, value: Any, time: int) -> None:
        self._add(topic, documents.encode(value), time)

    def _line(self, text: str, time: int, *, warning: bool = False) -> None:
        self._protobuf(channels.LOG_LINES, messages.encode_line(text, time, warning=warning), time)

    def _flush(self) -> None:
        """Complete the chunk and hand all to the operating system."""
        self._mcap.flush()  # type: ignore[no-untyped-call]

    def _add(self, topic: str, data: bytes, time: int) -> None:
        if channels.chunk_of(topic) != self._chunk:
            self._flush()
            self._chunk = channels.chunk_of(topic)
        log_time = self._time(self._now())
        self._mcap.add_message(self._channels[topic], log_time, data, publish_time=time)

    @contextlib.contextmanager
    def _guard(self) -> Iterator[None]:
        """Turn a full disk into a LogError; what reached it before stays readable."""
        if self._failure is not None:
            raise LogError(self._failure)
        try:
            yield
        except OSError as error:
            self._failure = (
                f"{self.part}: cannot be written ({error.strerror}); "
                f"what was logged up to action {self._step} stays readable there"
            )
            with contextlib.suppress(OSError):
                self._file.close()
            raise LogError(self._failure) from error


def _look(
    frame: RgbdFrame, heightmap: Heightmap, X_base_camera: Transform, time: int
) -> dict[str, Message]:
    """What a look shows, by topic."""
    seen = pictures.enlarge(heightmap.color)
    if heightmap.goal is not None:
        pictures.draw_goal(seen, heightmap.goal)
    rim = {}
    if heightmap.rim is not None:
        rim[channels.HEIGHTMAP_RIM] = messages.encode_rim(heightmap.rim, heightmap.workspace, time)
    return {
        channels.TRANSFORMS: messages.encode_transform(
            channels.BASE, channels.CAMERA, X_base_camera, time
        ),
        channels.PREVIEW: messages.encode_preview(frame.color, time, channels.CAMERA),
        channels.HEIGHTMAP_COLOR: messages.encode_picture(seen, time, channels.MAP),
        channels.COLOR: messages.encode_picture(frame.color, time, channels.CAMERA),
        channels.CALIBRATION: messages.encode_calibration(frame.intrinsics, time),
        channels.DEPTH: messages.encode_depth(frame.depth, time),
        channels.HEIGHTMAP: messages.encode_heightmap(heightmap, time),
        **rim,
        channels.HEIGHTMAP_POINTS: messages.encode_points(heightmap, time),
    }
