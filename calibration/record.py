"""Every view as it was taken, in one MCAP: picture, depth, joints, tool pose, times.

`/setup` (JSON) comes first: date, mounting, board, workspace. Then for each view `/picture` and
`/depth` (PNG in foxglove.CompressedImage; depth in 0.1 mm, 0 where unknown), closed by `/view`
(JSON: everything but the pictures), or by `/table` for the look at the table without the board. A
file cut short by a crash is read up to its last whole view.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from calibration.target import CharucoTarget
from calibration.views import Mounting
from tdpg_deploy.cell_config import WorkspaceSection
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

PROFILE = "tdpg-calibration/1"
DEPTH_UNIT = 1e-4  # m


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedView:
    """color: (H, W, 3) RGB. depth: (H, W) metres, nan unknown. q: (6,) rad.

    stamp: of the arm's state; captured_at: of the picture; seconds on the cell's clock.
    """

    name: str
    color: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    intrinsics: Intrinsics
    serial: str
    q: Array
    X_base_tool: Transform
    stamp: float
    captured_at: float


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What stays the same over all views."""

    mounting: Mounting
    target: CharucoTarget
    workspace: WorkspaceSection


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """date: when it was begun. table: the look at the table with the arm out of sight; None until
    it was taken."""

    setup: Setup
    date: datetime
    views: list[RecordedView]
    table: RecordedView | None


class RecordWriter:
    """Each view is on disk when `add` returns. Opens its file on entry."""

    def __init__(self, path: Path, setup: Setup, date: datetime) -> None:
        self._path = path
        self._head = _head_document(setup, date)

    def __enter__(self) -> RecordWriter:
        try:
            self._file = self._path.open("wb")
        except OSError as error:
            raise CalibrationError(f"{self._path}: cannot be written ({error.strerror})") from error
        # Each message is a chunk of its own: whatever happens next, it stays readable.
        self._writer = Writer(self._file, chunk_size=1)
        self._writer.start(profile=PROFILE, library="tdpg-deploy")
        schema = self._writer.register_schema("tdpg.CalibrationView", "jsonschema", b"{}")
        image = register_schema(self._writer, CompressedImage)
        self._channels = {
            "setup": self._writer.register_channel("/setup", "json", schema),
            "view": self._writer.register_channel("/view", "json", schema),
            "table": self._writer.register_channel("/table", "json", schema),
            "picture": self._writer.register_channel("/picture", "protobuf", image),
            "depth": self._writer.register_channel("/depth", "protobuf", image),
        }
        self._message("setup", self._head, 0)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def add(self, view: RecordedView) -> None:
        self._add("view", view)

    def add_table(self, view: RecordedView) -> None:
        self._add("table", view)

    def _add(self, channel: str, view: RecordedView) -> None:
        time = round(view.captured_at * 1e9)
        counts = np.nan_to_num(view.depth / DEPTH_UNIT, nan=0.0).clip(0, 65535).round()
        self._image("picture", np.ascontiguousarray(view.color[..., ::-1]), time)
        self._image("depth", counts.astype(np.uint16), time)
        document = {
            "name": view.name,
            "intrinsics": asdict(view.intrinsics),
            "serial": view.serial,
            "q": view.q.tolist(),
            "position": view.X_base_tool.translation.tolist(),
            "quaternion": view.X_base_tool.as_quaternion().tolist(),
            "stamp": view.stamp,
            "captured_at": view.captured_at,
        }
        self._message(channel, json.dumps(document).encode(), time)
        self._file.flush()

    def _image(self, channel: str, picture: npt.NDArray[np.integer[Any]], time: int) -> None:
        message = CompressedImage(format="png", frame_id="camera")
        message.timestamp.FromNanoseconds(time)
        message.data = cv2.imencode(".png", picture)[1].tobytes()
        self._message(channel, message.SerializeToString(), time)

    def _message(self, channel: str, data: bytes, time: int) -> None:
        self._writer.add_message(
            self._channels[channel], log_time=time, publish_time=time, data=data
        )


def read_record(path: Path) -> Record:
    """Raises CalibrationError."""
    head: tuple[Setup, datetime] | None = None
    views: list[RecordedView] = []
    table: RecordedView | None = None
    pictures: dict[str, bytes] = {}
    try:
        for topic, data in _messages(path):
            if topic == "/setup":
                head = _head(data)
            elif topic == "/view":
                views.append(_view(data, pictures))
            elif topic == "/table":
                table = _view(data, pictures)
            else:
                pictures[topic] = data
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read ({error.strerror})") from error
    if head is None:
        raise CalibrationError(f"{path}: does not say with which board it was taken; collect anew")
    return Record(setup=head[0], date=head[1], views=views, table=table)


def _messages(path: Path) -> Iterator[tuple[str, bytes]]:
    with path.open("rb") as file:
        if file.read(5) != b"\x89MCAP":
            raise CalibrationError(f"{path}: not an MCAP record of a calibration")
        file.seek(0)
        try:
            for _, channel, message in NonSeekingReader(file).iter_messages():
                yield channel.topic, message.data
        except McapError:
            return  # cut short: what is whole has been read


def _head_document(setup: Setup, date: datetime) -> bytes:
    document = {
        "date": date.isoformat(),
        "mounting": setup.mounting.value,
        "target": asdict(setup.target),
        "workspace": setup.workspace.model_dump(),
    }
    return json.dumps(document).encode()


def _head(data: bytes) -> tuple[Setup, datetime]:
    try:
        d = json.loads(data)
        setup = Setup(
            mounting=Mounting(d["mounting"]),
            target=CharucoTarget(**d["target"]),
            workspace=WorkspaceSection(**d["workspace"]),
        )
        return setup, datetime.fromisoformat(d["date"])
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"the head of the record is damaged: {error!r}") from error


def _view(data: bytes, pictures: dict[str, bytes]) -> RecordedView:
    try:
        d = json.loads(data)
        lens = d["intrinsics"]
        color = _decode(pictures["/picture"], cv2.IMREAD_COLOR)
        counts = _decode(pictures["/depth"], cv2.IMREAD_UNCHANGED)
        return RecordedView(
            name=str(d["name"]),
            color=np.ascontiguousarray(color[..., ::-1], np.uint8),
            depth=np.where(counts == 0, np.nan, counts * DEPTH_UNIT).astype(np.float32),
            intrinsics=Intrinsics(**{**lens, "distortion": tuple(lens["distortion"])}),
            serial=str(d["serial"]),
            q=np.array(d["q"], np.float64),
            X_base_tool=Transform.from_quaternion(d["position"], d["quaternion"]),
            stamp=float(d["stamp"]),
            captured_at=float(d["captured_at"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"a view of the record is damaged: {error!r}") from error


def _decode(data: bytes, flags: int) -> npt.NDArray[np.integer[Any]]:
    picture = cv2.imdecode(np.frombuffer(CompressedImage.FromString(data).data, np.uint8), flags)
    if picture is None:
        raise ValueError("a picture that is no PNG")
    return np.asarray(picture, np.uint16 if picture.dtype == np.uint16 else np.uint8)


def record_hash(path: Path) -> str:
    """SHA-256 in hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
