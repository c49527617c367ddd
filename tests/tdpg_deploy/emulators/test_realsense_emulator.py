"""The emulated D435 as any program sees it that uses pyrealsense2, without our driver."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from emulated_d435 import INTRINSICS, SERIAL, Scene
from scipy.spatial.transform import Rotation

from tdpg_deploy.drivers.realsense_library import load_realsense
from tdpg_deploy.drivers.realsense_source import StreamFormat
from tdpg_deploy.emulators.realsense import DepthCamera, EmulatedD435, holes, stale, torn
from tdpg_deploy.errors import CameraError
from tdpg_deploy.geometry import Transform

VGA = StreamFormat(width=640, height=480, fps=30)


@pytest.fixture
def rs() -> Any:
    return load_realsense()


@pytest.fixture
def source() -> EmulatedD435:
    return EmulatedD435(Scene().frame, serial=SERIAL)


@pytest.fixture
def started(source: EmulatedD435) -> Iterator[tuple[Any, Any]]:
    pipeline, profile = source.start(VGA)
    yield pipeline, profile
    source.stop(pipeline)


def pair(pipeline: Any) -> tuple[Any, Any]:
    frames = pipeline.wait_for_frames(5000)
    return frames.get_depth_frame(), frames.get_color_frame()


def test_it_looks_like_a_d435(rs: Any, started: tuple[Any, Any]) -> None:
    _, profile = started
    device = profile.get_device()
    assert "D435" in device.get_info(rs.camera_info.name)
    assert device.get_info(rs.camera_info.serial_number) == SERIAL
    assert [sensor.name for sensor in device.sensors] == ["Stereo Module", "RGB Camera"]
    assert device.first_depth_sensor().get_depth_scale() == pytest.approx(0.001)
    assert device.first_depth_sensor().get_option(rs.option.stereo_baseline) == 50.0
    color = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
    assert (color.width, color.height) == (640, 480)
    assert (color.fx, color.fy, color.ppx, color.ppy) == (611.5, 610.25, 322.5, 238.75)
    assert color.coeffs == pytest.approx(INTRINSICS.distortion)


def test_twenty_pairs_in_lockstep_and_exact(started: tuple[Any, Any]) -> None:
    pipeline, _ = started
    scene = Scene()
    numbers = []
    for _ in range(20):
        depth, color = pair(pipeline)
        assert depth.get_frame_number() == color.get_frame_number()
        assert depth.get_timestamp() == color.get_timestamp()
        numbers.append(depth.get_frame_number())
    assert numbers == sorted(set(numbers))
    assert (np.asanyarray(color.get_data()) == scene.color).all()
    metres = np.asanyarray(depth.get_data()) * depth.get_units()
    np.testing.assert_allclose(metres, np.nan_to_num(scene.depth), rtol=1e-6)


def test_a_depth_camera_apart_has_its_own_intrinsics_and_place(rs: Any) -> None:
    X_color_depth = Transform(Rotation.from_rotvec([0.01, -0.02, 0.03]), np.array([0.015, 0, 0]))
    apart = DepthCamera(intrinsics=INTRINSICS, X_color_depth=X_color_depth)
    source = EmulatedD435(Scene().frame, depth_camera=apart)
    pipeline, profile = source.start(VGA)
    depth, color = (profile.get_stream(kind) for kind in (rs.stream.depth, rs.stream.color))
    p_depth = [0.1, -0.2, 0.7]
    p_color = rs.rs2_transform_point_to_point(depth.get_extrinsics_to(color), p_depth)
    np.testing.assert_allclose(p_color, X_color_depth @ np.array(p_depth), atol=1e-6)
    source.stop(pipeline)


def test_faults_are_what_they_say(source: EmulatedD435, started: tuple[Any, Any]) -> None:
    pipeline, _ = started
    source.fault = holes(0.5)
    deadline = 50
    while np.asanyarray(pair(pipeline)[0].get_data())[:, :320].any():
        deadline -= 1
        assert deadline
    assert np.asanyarray(pair(pipeline)[0].get_data())[:, 320:].any()
    exposure = source._expose()
    late = stale(2.0)(exposure)
    assert late is not None
    assert exposure.depth_at - late.depth_at == pytest.approx(2.0)
    assert exposure.color_at - late.color_at == pytest.approx(2.0)
    parted = torn(0.2)(exposure)
    assert parted is not None
    assert parted.depth_at - parted.color_at == pytest.approx(0.2)


def test_a_source_of_another_size_is_refused(source: EmulatedD435) -> None:
    with pytest.raises(CameraError, match="shows 640x480, asked for 1280x720"):
        source.start(StreamFormat(width=1280, height=720, fps=6))


def test_stopping_leaves_no_thread(source: EmulatedD435) -> None:
    before = threading.active_count()
    for _ in range(3):
        pipeline, _ = source.start(VGA)
        source.stop(pipeline)
    assert threading.active_count() == before
