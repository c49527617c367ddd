"""Encodings against what the formats' own definitions and OpenCV say, and back without loss."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation
from synthetic_episode import WORKSPACE, Synthetic

from policies.heightmap import PIXEL, SIZE, WIDE, Heightmap, Workspace
from tdpg_deploy.episode_log import messages
from tdpg_deploy.episode_log.channels import CAMERA, TOOL
from tdpg_deploy.errors import LogError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Intrinsics

finite = st.floats(-1e6, 1e6)
shapes = st.tuples(st.integers(1, 6), st.integers(1, 6))


def identical(a: npt.NDArray[np.generic], b: npt.NDArray[np.generic]) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


# --- time -------------------------------------------------------------------------------------


@given(st.floats(1e9, 4e9))
def test_calendar_times_survive_exactly(seconds: float) -> None:
    """A float of that size steps by 238 ns or more, so the nearest nanosecond names it."""
    assert messages.nanoseconds(seconds) / 1_000_000_000 == seconds


@given(st.floats(-1e6, 1e6))
def test_other_times_to_the_nanosecond(seconds: float) -> None:
    assert abs(messages.nanoseconds(seconds) / 1e9 - seconds) <= 0.6e-9


def test_timestamp_has_nanoseconds_of_its_second() -> None:
    stamp = messages.timestamp(1_764_000_000_250_000_001)
    assert (stamp.seconds, stamp.nanos) == (1_764_000_000, 250_000_001)


# --- images -----------------------------------------------------------------------------------


@given(shapes.flatmap(lambda shape: hnp.arrays(np.uint8, (*shape, 3))))
def test_pictures_are_lossless(rgb: npt.NDArray[np.uint8]) -> None:
    message = messages.encode_picture(rgb, 7, CAMERA)
    assert identical(messages.decode_picture(message), rgb)


def test_red_is_red_to_opencv() -> None:
    rgb = np.full((4, 5, 3), (255, 0, 0), np.uint8)
    message = messages.encode_picture(rgb, 7, CAMERA)
    assert message.format == "png"
    bgr = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    assert bgr[0, 0].tolist() == [0, 0, 255]


@pytest.mark.parametrize(("width", "shown"), [(1280, 640), (640, 640), (64, 64)])
def test_a_preview_is_the_picture_made_small(width: int, shown: int) -> None:
    rgb = np.zeros((width // 2, width, 3), np.uint8)
    rgb[:, width // 2 :] = 250, 120, 10
    message = messages.encode_preview(rgb, 7, CAMERA)
    assert (message.format, message.frame_id) == ("jpeg", CAMERA)
    bgr = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    assert bgr.shape == (shown // 2, shown, 3)
    np.testing.assert_allclose(bgr[5, -5], (10, 120, 250), atol=4)
    np.testing.assert_allclose(bgr[5, 5], 0, atol=4)


@given(shapes.flatmap(lambda shape: hnp.arrays(np.uint16, shape)))
def test_depth_in_millimetres_takes_two_bytes(counts: npt.NDArray[np.uint16]) -> None:
    depth = counts.astype(np.float32) * np.float32(0.001)  # as librealsense computes metres
    depth[counts == 0] = np.nan
    message = messages.encode_depth(depth, 7)
    assert message.encoding == "16UC1"
    assert np.array_equal(np.frombuffer(message.data, "<u2").reshape(depth.shape), counts)
    assert identical(messages.decode_depth(message), depth)


@given(shapes.flatmap(lambda shape: hnp.arrays(np.float32, shape)))
def test_any_depth_is_lossless(depth: npt.NDArray[np.float32]) -> None:
    back = messages.decode_depth(messages.encode_depth(depth, 7))
    assert back.dtype == np.float32
    assert np.array_equal(back, depth, equal_nan=True)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (RawImage(width=2, height=2, encoding="rgb8", data=b"x" * 12), "rgb8"),
        (RawImage(width=2, height=2, encoding="16UC1", data=b"x" * 7), "7 bytes instead of 8"),
        (RawImage(width=0, height=0, encoding="16UC1"), "0 bytes"),
    ],
)
def test_depth_that_contradicts_itself(message: RawImage, reason: str) -> None:
    with pytest.raises(LogError, match=reason):
        messages.decode_depth(message)


def test_a_huge_picture_is_refused_before_it_is_decoded() -> None:
    png = bytearray(messages.encode_picture(np.zeros((4, 4, 3), np.uint8), 7, CAMERA).data)
    png[16:24] = (60_000).to_bytes(4, "big") * 2
    with pytest.raises(LogError, match="at most 4096"):
        messages.decode_picture(CompressedImage(data=bytes(png)))


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff\xe0 a JPEG", b"\x89PNG\r\n\x1a\n"])
def test_other_bytes_are_no_picture(data: bytes) -> None:
    with pytest.raises(LogError, match="not a PNG"):
        messages.decode_picture(CompressedImage(data=data))


# --- camera, frames, joints -------------------------------------------------------------------


@given(st.tuples(*[finite] * 4), st.tuples(*[finite] * 5))
def test_calibration_comes_back(
    pinhole: tuple[float, ...], distortion: tuple[float, float, float, float, float]
) -> None:
    fx, fy, cx, cy = pinhole
    intrinsics = Intrinsics(
        width=640, height=480, fx=fx, fy=fy, cx=cx, cy=cy, distortion=distortion
    )
    message = messages.encode_calibration(intrinsics, 7)
    assert message.frame_id == CAMERA
    assert list(message.K) == [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    assert list(message.P) == [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]
    assert messages.decode_calibration(message) == intrinsics


def test_transform_comes_back_and_names_its_frames() -> None:
    rotation = Rotation.from_euler("xyz", [0.3, -1.2, 2.0])
    pose = Transform(rotation, np.array([0.1, -0.2, 0.3]))
    message = messages.encode_transform("base", TOOL, pose, 7)
    assert message.transforms[0].parent_frame_id == "base"
    back = messages.decode_transform(message, TOOL)
    assert back is not None
    np.testing.assert_allclose(back.as_matrix(), pose.as_matrix(), atol=1e-15)
    assert messages.decode_transform(message, CAMERA) is None


def test_a_rotation_of_zeros_is_no_pose() -> None:
    message = FrameTransforms()
    message.transforms.add(child_frame_id=TOOL)
    with pytest.raises(LogError, match="not a pose of tool"):
        messages.decode_transform(message, TOOL)


@given(hnp.arrays(np.float64, 6), hnp.arrays(np.float64, 6))
def test_joints_come_back(q: npt.NDArray[np.float64], qd: npt.NDArray[np.float64]) -> None:
    message = messages.encode_joints(q, qd, 7)
    assert [joint.name for joint in message.joints][:3] == [
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
    ]
    back_q, back_qd = messages.decode_joints(message)
    assert np.array_equal(back_q, q, equal_nan=True)
    assert np.array_equal(back_qd, qd, equal_nan=True)


# --- heightmap --------------------------------------------------------------------------------


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.tuples(finite, finite, finite))
def test_heightmaps_are_lossless(seed: int, goal: bool, corner: tuple[float, ...]) -> None:
    rng = np.random.default_rng(seed)
    height = rng.integers(0, 2**32, (SIZE, SIZE), np.uint32).view(np.float32)  # any bits at all
    heightmap = Heightmap(
        workspace=Workspace(x_min=corner[0], y_min=corner[1], table_z=corner[2]),
        color=rng.integers(0, 256, (SIZE, SIZE, 3), np.uint8),
        height=height,
        goal=rng.random((SIZE, SIZE)) < 0.1 if goal else None,
    )
    grid = messages.encode_heightmap(heightmap, 7)
    assert messages.decode_heightmap(grid, None).rim is None
    rim = rng.random((WIDE, WIDE), np.float32)
    back = messages.decode_heightmap(grid, messages.encode_rim(rim, heightmap.workspace, 7))
    assert back.rim is not None
    assert identical(back.rim, rim)
    assert back.workspace == heightmap.workspace
    assert identical(back.color, heightmap.color)
    assert identical(back.height, heightmap.height)
    if heightmap.goal is None:
        assert back.goal is None
    else:
        assert back.goal is not None
        assert identical(back.goal, heightmap.goal)


def test_a_cell_lies_in_3d_where_its_pixel_was_seen() -> None:
    """By the formula in Grid's own definition: cell i lies at row i / row_stride along y and
    column (i % row_stride) / cell_stride along x, from the corner closest to the origin."""
    row, col = 17, 150
    height = np.zeros((SIZE, SIZE), np.float32)
    color = np.zeros((SIZE, SIZE, 3), np.uint8)
    height[row, col], color[row, col] = 0.04, (1, 2, 3)
    heightmap = Heightmap(workspace=WORKSPACE, color=color, height=height)
    grid = messages.encode_heightmap(heightmap, 7)
    at = {field.name: field.offset for field in grid.fields}
    cells = [
        start
        for start in range(0, len(grid.data), grid.cell_stride)
        if grid.data[start + at["green"]] == 2
    ]
    [start] = cells
    x = grid.pose.position.x + (start % grid.row_stride // grid.cell_stride + 0.5) * PIXEL
    y = grid.pose.position.y + (start // grid.row_stride + 0.5) * PIXEL
    np.testing.assert_allclose((x, y), WORKSPACE.to_base(row, col), atol=1e-12)
    elevation = np.frombuffer(grid.data, "<f4", 1, start + at["elevation"])
    assert elevation[0] == np.float32(0.04)
    assert grid.pose.position.z == WORKSPACE.table_z


def test_points_lie_on_the_surface() -> None:
    synthetic = Synthetic()
    heightmap = synthetic.heightmap(synthetic.blocks(3))
    cloud = messages.encode_points(heightmap, 7)
    assert [field.name for field in cloud.fields][:3] == ["x", "y", "z"]
    assert cloud.point_stride == 16
    points = np.frombuffer(cloud.data, "<f4").reshape(-1, 4)[:, :3].astype(np.float64)
    rows, cols = WORKSPACE.to_pixel(points[:, 0], points[:, 1])
    np.testing.assert_allclose(
        points[:, 2] - WORKSPACE.table_z, heightmap.height[rows, cols], atol=1e-7
    )
    assert len(points) == heightmap.valid[::2, ::2].sum()


def test_a_heightmap_of_another_size() -> None:
    with pytest.raises(LogError, match="expected 224x224 cells"):
        messages.decode_heightmap(Grid(data=b"1234", cell_stride=8), None)
    height = np.zeros((SIZE, SIZE), np.float32)
    color = np.zeros((SIZE, SIZE, 3), np.uint8)
    grid = messages.encode_heightmap(Heightmap(workspace=WORKSPACE, color=color, height=height), 7)
    with pytest.raises(LogError, match="expected 304x304 cells"):
        messages.decode_heightmap(grid, grid)


def test_other_bytes_are_no_message() -> None:
    with pytest.raises(LogError, match="not a Grid message"):
        messages.parse(Grid, b"\xff\xff\xff")
