"""Our own types to and from foxglove.* protobuf messages. Pure.

`time` is in nanoseconds since the UNIX epoch. What the policy sees and what the camera gave make
the round trip without loss.
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import DecodeError
from google.protobuf.timestamp_pb2 import Timestamp

from policies.heightmap import PIXEL, RIM, SIZE, WIDE, Heightmap, Workspace
from tdpg_deploy.episode_log.channels import BASE, CAMERA
from tdpg_deploy.errors import LogError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import DOF, Intrinsics

JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)

PNG_LEVEL = 1  # of a noisy 720p image: 0.6 of the time of the default, for 2 % more bytes
PREVIEW_WIDTH = 640  # pixels
PREVIEW_QUALITY = 82  # of JPEG
MAX_SIDE = 4096  # pixels; no camera of ours is larger, and a hostile header may not cost memory
MILLIMETRE = np.float32(0.001)  # metres a count of the D435's Z16 stream, as librealsense has it

M = TypeVar("M")


def parse(message: type[M], data: bytes) -> M:
    """A protobuf message of this class. Raises LogError."""
    try:
        parsed: M = message.FromString(data)  # type: ignore[attr-defined]
    except DecodeError as error:
        raise LogError(f"not a {message.__name__} message: {error}") from error
    return parsed


# --- time -------------------------------------------------------------------------------------


def nanoseconds(seconds: float) -> int:
    """Nearest nanosecond, computed on integers: 1.7e9 s has no room for them in a float."""
    whole = int(seconds // 1)
    return whole * 1_000_000_000 + round((seconds - whole) * 1e9)


def timestamp(time: int) -> Timestamp:
    """Nanoseconds since the UNIX epoch as protobuf has it."""
    return Timestamp(seconds=time // 1_000_000_000, nanos=time % 1_000_000_000)


# --- images -----------------------------------------------------------------------------------


def encode_picture(rgb: npt.NDArray[np.uint8], time: int, frame_id: str) -> CompressedImage:
    """(H, W, 3) uint8 RGB -> PNG: lossless, and every viewer opens it."""
    bgr = np.ascontiguousarray(rgb[..., ::-1])
    done, png = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    assert done
    return CompressedImage(
        timestamp=timestamp(time), frame_id=frame_id, format="png", data=png.tobytes()
    )


def encode_preview(rgb: npt.NDArray[np.uint8], time: int, frame_id: str) -> CompressedImage:
    """(H, W, 3) uint8 RGB -> a small JPEG, to be looked at only."""
    scale = min(1.0, PREVIEW_WIDTH / rgb.shape[1])
    small = cv2.resize(rgb, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    quality = [cv2.IMWRITE_JPEG_QUALITY, PREVIEW_QUALITY]
    done, jpeg = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), quality)
    assert done
    return CompressedImage(
        timestamp=timestamp(time), frame_id=frame_id, format="jpeg", data=jpeg.tobytes()
    )


def decode_picture(message: CompressedImage) -> npt.NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB of a PNG. Raises LogError."""
    png = message.data
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))  # IHDR
    if not png.startswith(b"\x89PNG") or not 0 < width <= MAX_SIDE or not 0 < height <= MAX_SIDE:
        raise LogError(f"not a PNG image of at most {MAX_SIDE} pixels a side")
    try:
        bgr = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise LogError(f"a PNG image that cannot be decoded: {error}") from error
    if bgr is None:
        raise LogError("a PNG image that cannot be decoded")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def encode_depth(depth: npt.NDArray[np.float32], time: int) -> RawImage:
    """(H, W) float32 metres, nan where unknown, without loss.

    As whole millimetres (16UC1, zero where unknown) if the camera counted in them, as a D435
    does; else as they are (32FC1), in four times the room.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        counts = np.nan_to_num(np.round(depth / MILLIMETRE), nan=0.0).clip(0, 0xFFFF)
    counts = counts.astype("<u2")
    exact = np.array_equal(_metres(counts), depth, equal_nan=True)
    encoding, pixels = ("16UC1", counts) if exact else ("32FC1", depth.astype("<f4"))
    height, width = depth.shape
    return RawImage(
        timestamp=timestamp(time),
        frame_id=CAMERA,
        width=width,
        height=height,
        encoding=encoding,
        step=width * pixels.itemsize,
        data=pixels.tobytes(),
    )


def decode_depth(message: RawImage) -> npt.NDArray[np.float32]:
    """(H, W) float32 metres, nan where unknown. Raises LogError."""
    dtype = {"16UC1": "<u2", "32FC1": "<f4"}.get(message.encoding)
    if dtype is None:
        raise LogError(
            f"depth image in {message.encoding!r:.40}; this version reads 16UC1 and 32FC1"
        )
    size = message.width * message.height * np.dtype(dtype).itemsize
    if len(message.data) != size or not size:
        raise LogError(
            f"depth image of {message.width}x{message.height} {message.encoding} pixels "
            f"has {len(message.data)} bytes instead of {size}"
        )
    pixels = np.frombuffer(message.data, dtype).reshape(message.height, message.width)
    return _metres(pixels) if dtype == "<u2" else pixels.astype(np.float32)


def _metres(counts: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    return np.where(counts == 0, np.float32(np.nan), counts.astype(np.float32) * MILLIMETRE)


# --- camera -----------------------------------------------------------------------------------


def encode_calibration(intrinsics: Intrinsics, time: int) -> CameraCalibration:
    k = intrinsics.as_matrix()
    return CameraCalibration(
        timestamp=timestamp(time),
        frame_id=CAMERA,
        width=intrinsics.width,
        height=intrinsics.height,
        distortion_model="plumb_bob",
        D=intrinsics.distortion,
        K=k.ravel(),
        R=np.eye(3).ravel(),
        P=np.hstack([k, np.zeros((3, 1))]).ravel(),
    )


def decode_calibration(message: CameraCalibration) -> Intrinsics:
    """Raises LogError."""
    if len(message.K) != 9 or len(message.D) != 5 or message.distortion_model != "plumb_bob":
        raise LogError("camera calibration without a 3x3 matrix and five plumb_bob parameters")
    k1, k2, p1, p2, k3 = message.D
    return Intrinsics(
        width=message.width,
        height=message.height,
        fx=message.K[0],
        fy=message.K[4],
        cx=message.K[2],
        cy=message.K[5],
        distortion=(k1, k2, p1, p2, k3),
    )


# --- frames and joints ------------------------------------------------------------------------


def encode_transform(parent: str, child: str, pose: Transform, time: int) -> FrameTransforms:
    """`pose` is X_parent_child."""
    x, y, z, w = pose.rotation.as_quat()
    transform = FrameTransform(
        timestamp=timestamp(time),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=vector(pose.translation),
        rotation=Quaternion(x=x, y=y, z=z, w=w),
    )
    return FrameTransforms(transforms=[transform])


def decode_transform(message: FrameTransforms, child: str) -> Transform | None:
    """X_parent_child, or None if the message tells of other frames. Raises LogError."""
    for transform in message.transforms:
        if transform.child_frame_id == child:
            p, q = transform.translation, transform.rotation
            try:
                return Transform.from_quaternion((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
            except ValueError as error:
                raise LogError(f"not a pose of {child}: {error}") from error
    return None


def decode_translation(message: FrameTransforms, child: str) -> tuple[float, float, float] | None:
    """Of X_parent_child, or None if the message tells of other frames."""
    for transform in message.transforms:
        if transform.child_frame_id == child:
            p = transform.translation
            return p.x, p.y, p.z
    return None


def vector(xyz: npt.ArrayLike) -> Vector3:
    x, y, z = np.asarray(xyz, np.float64)
    return Vector3(x=x, y=y, z=z)


def encode_joints(q: Array, qd: Array, time: int) -> JointStates:
    """q, qd: (6,) rad and rad/s."""
    joints = [
        JointState(name=name, position=position, velocity=velocity)
        for name, position, velocity in zip(JOINT_NAMES, q, qd, strict=True)
    ]
    return JointStates(timestamp=timestamp(time), joints=joints)


def decode_joints(message: JointStates) -> tuple[Array, Array]:
    """q, qd: (6,) rad and rad/s. Raises LogError."""
    if len(message.joints) != DOF:
        raise LogError(f"{len(message.joints)} joints instead of {DOF}")
    return (
        np.array([joint.position for joint in message.joints]),
        np.array([joint.velocity for joint in message.joints]),
    )


# --- heightmap --------------------------------------------------------------------------------

_CELL = [("red", "u1"), ("green", "u1"), ("blue", "u1"), ("alpha", "u1"), ("elevation", "<f4")]
_GOAL = ("goal", "u1")
_RIM = _CELL[4:]
_POINT = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), *_CELL[:4]]
POINT_STRIDE = (
    2  # pixels; a picture for viewers that draw no Grid in relief, at a quarter of the size
)
_NUMERIC = {"u1": PackedElementField.UINT8, "<f4": PackedElementField.FLOAT32}


def _fields(layout: list[tuple[str, str]]) -> list[PackedElementField]:
    """Of elements that are packed without gaps."""
    sizes = [np.dtype(kind).itemsize for _, kind in layout]
    return [
        PackedElementField(name=name, offset=sum(sizes[:i]), type=_NUMERIC[kind])
        for i, (name, kind) in enumerate(layout)
    ]


def encode_heightmap(heightmap: Heightmap, time: int) -> Grid:
    """Without loss, lying where it was seen.

    A Grid's rows run along +y and its columns along +x; ours run along -x and -y of base.
    """
    layout = [*_CELL, _GOAL] if heightmap.goal is not None else _CELL
    cells = np.empty((SIZE, SIZE), layout)
    for channel, name in enumerate(("red", "green", "blue")):
        cells[name] = heightmap.color[..., channel]
    cells["alpha"] = np.where(heightmap.valid, 255, 0)
    cells["elevation"] = heightmap.height
    if heightmap.goal is not None:
        cells["goal"] = heightmap.goal
    return _encode_grid(cells, layout, heightmap.workspace, 0, time)


def encode_rim(rim: npt.NDArray[np.float32], workspace: Workspace, time: int) -> Grid:
    """What was seen around a heightmap, without loss."""
    return _encode_grid(rim.view(_RIM), _RIM, workspace, RIM, time)


def _encode_grid(
    cells: npt.NDArray[np.void],
    layout: list[tuple[str, str]],
    workspace: Workspace,
    around: int,
    time: int,
) -> Grid:
    """Cells (n, n) of the workspace and of so many pixels around it."""
    border = around * PIXEL
    return Grid(
        timestamp=timestamp(time),
        frame_id=BASE,
        pose=Pose(
            position=Vector3(
                x=workspace.x_min - border, y=workspace.y_min - border, z=workspace.table_z
            ),
            orientation=Quaternion(x=0, y=0, z=0, w=1),
        ),
        column_count=len(cells),
        cell_size=Vector2(x=PIXEL, y=PIXEL),
        row_stride=len(cells) * cells.itemsize,
        cell_stride=cells.itemsize,
        fields=_fields(layout),
        data=cells.T[::-1, ::-1].tobytes(),
    )


def decode_heightmap(message: Grid, rim: Grid | None) -> Heightmap:
    """rim: None in logs that have none. Raises LogError."""
    has_goal = any(field.name == "goal" for field in message.fields)
    cells = _decode_grid(message, SIZE, [*_CELL, _GOAL] if has_goal else _CELL)
    corner = message.pose.position
    return Heightmap(
        workspace=Workspace(x_min=corner.x, y_min=corner.y, table_z=corner.z),
        color=np.stack([cells["red"], cells["green"], cells["blue"]], axis=-1),
        height=_elevation(cells),
        goal=cells["goal"].astype(np.bool_) if has_goal else None,
        rim=None if rim is None else _elevation(_decode_grid(rim, WIDE, _RIM)),
    )


def _elevation(cells: npt.NDArray[np.void]) -> npt.NDArray[np.float32]:
    return np.ascontiguousarray(cells["elevation"], np.float32)


def _decode_grid(message: Grid, side: int, layout: list[tuple[str, str]]) -> npt.NDArray[np.void]:
    """(side, side) cells. Raises LogError."""
    cell = np.dtype(layout)
    size, stride = len(message.data), message.cell_stride
    if size != side * side * cell.itemsize or stride != cell.itemsize:
        raise LogError(
            f"heightmap of {size} bytes in cells of {stride}; expected {side}x{side} cells of "
            f"{cell.itemsize} bytes"
        )
    return np.frombuffer(message.data, cell).reshape(side, side)[::-1, ::-1].T


def encode_points(heightmap: Heightmap, time: int) -> PointCloud:
    """Every second pixel that was seen, in base. To be looked at only."""
    rows, cols = np.mgrid[:SIZE:POINT_STRIDE, :SIZE:POINT_STRIDE].reshape(2, -1)
    seen = heightmap.valid[rows, cols]
    rows, cols = rows[seen], cols[seen]
    points = np.empty(len(rows), _POINT)
    points["x"], points["y"] = heightmap.workspace.to_base(rows, cols)
    points["z"] = heightmap.workspace.table_z + heightmap.height[rows, cols]
    for channel, name in enumerate(("red", "green", "blue")):
        points[name] = heightmap.color[rows, cols, channel]
    points["alpha"] = 255
    return PointCloud(
        timestamp=timestamp(time),
        frame_id=BASE,
        pose=Pose(position=vector(np.zeros(3)), orientation=Quaternion(x=0, y=0, z=0, w=1)),
        point_stride=points.itemsize,
        fields=_fields(_POINT),
        data=points.tobytes(),
    )


# --- log lines --------------------------------------------------------------------------------


def encode_line(text: str, time: int, *, warning: bool = False) -> Log:
    level = Log.WARNING if warning else Log.INFO
    return Log(timestamp=timestamp(time), level=level, name="tdpg-deploy", message=text)
