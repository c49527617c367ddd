"""The camera driver on librealsense's own pipeline, before an emulated D435."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from emulated_d435 import INTRINSICS, SERIAL, Scene, emulated, section

from tdpg_deploy.cell import MachineClock
from tdpg_deploy.drivers.realsense import RealsenseCamera
from tdpg_deploy.drivers.realsense_library import load_realsense
from tdpg_deploy.emulators.realsense import (
    DepthCamera,
    EmulatedD435,
    first_exposures,
    stale,
    stalled,
    torn,
)
from tdpg_deploy.errors import CameraError, DeviceUnreachable
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Intrinsics, RgbdFrame


@pytest.fixture
def scene() -> Scene:
    return Scene()


def test_a_frame_is_what_is_before_the_lens(scene: Scene) -> None:
    with emulated(scene) as (camera, _):
        frame = camera.capture()
    assert (frame.color == scene.color).all()
    np.testing.assert_allclose(frame.depth, scene.depth, rtol=1e-6)  # and nan where nan
    assert frame.depth.dtype == np.float32
    assert frame.serial == SERIAL
    assert frame.intrinsics == camera_intrinsics(frame.intrinsics)


def camera_intrinsics(got: Intrinsics) -> Intrinsics:
    """INTRINSICS as librealsense keeps them: in single precision."""
    assert got.distortion == pytest.approx(INTRINSICS.distortion, rel=1e-6)
    return Intrinsics(
        width=640, height=480, fx=611.5, fy=610.25, cx=322.5, cy=238.75, distortion=got.distortion
    )


def test_a_frame_of_1280_by_720_is_exact() -> None:
    large = Scene(Intrinsics(width=1280, height=720, fx=920, fy=920, cx=640, cy=360))
    source = EmulatedD435(large.frame)
    section_720 = section().model_copy(update={"width": 1280, "fps": 6})
    camera = RealsenseCamera(section_720, clock=MachineClock(), source=source, warm_up=0.0)
    camera.connect()
    frame = camera.capture()
    camera.close()
    assert (frame.color == large.color).all()
    np.testing.assert_allclose(frame.depth, large.depth, rtol=1e-6)


def test_a_frame_shows_the_world_as_it_is_after_the_call(scene: Scene) -> None:
    with emulated(scene) as (camera, _):
        for value in range(5):
            scene.color = np.full_like(scene.color, value)
            before = time.time()
            frame = camera.capture()
            assert (frame.color == value).all()
            assert before <= frame.captured_at <= time.time()


def test_after_idling_no_old_frame_is_served(scene: Scene) -> None:
    with emulated(scene) as (camera, source):
        camera.capture()
        delivered = source.delivered
        deadline = time.monotonic() + 5.0
        while source.delivered < delivered + 20:  # more than librealsense queues
            assert time.monotonic() < deadline
            time.sleep(0.01)
        scene.color = np.full_like(scene.color, 9)
        assert (camera.capture().color == 9).all()


def test_sequence_grows_over_reconnection(scene: Scene) -> None:
    with emulated(scene) as (camera, _):
        first, second = camera.capture().sequence, camera.capture().sequence
        camera.close()
        camera.connect()
        assert first < second < camera.capture().sequence


def test_frames_may_be_kept(scene: Scene) -> None:
    with emulated(scene) as (camera, _):
        kept = [camera.capture() for _ in range(24)]  # about fifteen kept frames stall a stream
        scene.color = np.zeros_like(scene.color)
        camera.capture()
    assert all((frame.color == kept[0].color).all() for frame in kept)
    assert kept[0].depth.flags.owndata or kept[0].depth.base is None


def test_depth_of_a_camera_apart_is_aligned_to_colour(scene: Scene) -> None:
    # A plane z = 0.8 + 0.2 x, seen by a wider depth camera 15 mm to the side.
    wide = Intrinsics(width=640, height=480, fx=420, fy=420, cx=318, cy=241)
    offset = 0.015
    x_depth = (np.arange(640) - wide.cx) / wide.fx
    row = (0.8 + 0.2 * offset) / (1 - 0.2 * x_depth)
    scene.depth = np.tile(row, (480, 1)).astype(np.float32)
    scene.intrinsics = Intrinsics(width=640, height=480, fx=610, fy=610, cx=320, cy=240)
    X_color_depth = Transform(Transform.identity().rotation, np.array([offset, 0.0, 0.0]))
    with emulated(scene, DepthCamera(intrinsics=wide, X_color_depth=X_color_depth)) as (camera, _):
        frame = camera.capture()
    x_color = (np.arange(640) - 320) / 610
    expected = np.tile(0.8 / (1 - 0.2 * x_color), (480, 1))
    inner = (slice(20, -20), slice(20, -20))
    seen = np.isfinite(frame.depth[inner])
    assert seen.mean() > 0.95
    error = np.abs(frame.depth[inner] - expected[inner])[seen]
    assert error.max() < 0.0025  # 1 mm a count, and one pixel of the depth camera is 0.4 mm


def test_distortion_survives_to_opencv(scene: Scene) -> None:
    with emulated(scene) as (camera, _):
        intrinsics = camera.intrinsics
    point = np.array([[[0.1, -0.05, 0.6]]])
    zero = np.zeros(3)
    ours, _ = cv2.projectPoints(
        point, zero, zero, intrinsics.as_matrix(), np.array(intrinsics.distortion)
    )
    true, _ = cv2.projectPoints(
        point, zero, zero, INTRINSICS.as_matrix(), np.array(INTRINSICS.distortion)
    )
    np.testing.assert_allclose(ours, true, atol=1e-3)


def test_averaging_a_still_scene_lowers_the_noise() -> None:
    rng = np.random.default_rng(3)
    still, deviation = 0.7, 0.004

    class Noisy(Scene):
        def frame(self) -> RgbdFrame:
            self.depth = rng.normal(still, deviation, (480, 640)).astype(np.float32)
            return super().frame()

    with emulated(Noisy(), frames_averaged=9) as (camera, _):
        depth = camera.capture().depth
    assert np.nanstd(depth) == pytest.approx(deviation / 3, rel=0.05)


def test_librealsenses_filters_run(scene: Scene) -> None:
    scene.depth[200:204, 300:304] = np.nan
    with emulated(scene, filters=("spatial", "temporal", "hole filling")) as (camera, _):
        depth = camera.capture().depth
    assert np.isfinite(depth[200:204, 300:304]).all()  # filled


def test_options_reach_the_device(scene: Scene) -> None:
    rs = load_realsense()
    with emulated(scene, emitter=False, preset="high accuracy") as (camera, _):
        sensor = camera.device.first_depth_sensor()
        assert sensor.get_option(rs.option.emitter_enabled) == 0
        assert sensor.get_option(rs.option.visual_preset) == 3  # rs_option.h
    with emulated(scene) as (camera, _):
        sensor = camera.device.first_depth_sensor()
        assert sensor.get_option(rs.option.emitter_enabled) == 1
        assert sensor.get_option(rs.option.visual_preset) == 0  # left alone


def test_an_option_that_the_device_refuses_is_told(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise RuntimeError("object doesn't support option Visual Preset")

    monkeypatch.setattr(RealsenseCamera, "_set_options", refuse)
    threads = threading.active_count()
    with pytest.raises(CameraError, match=r"cannot be set up.*Visual Preset"), emulated(scene):
        pass
    assert threading.active_count() == threads


def test_a_short_fault_is_waited_out(scene: Scene) -> None:
    for fault in (stalled, stale(9.0), torn(0.2)):
        with emulated(scene) as (camera, source):
            source.fault = first_exposures(3, fault)
            assert camera.capture(deadline=5.0).sequence == 1


def test_half_a_pair_is_told(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    half = SimpleNamespace(get_depth_frame=lambda: None, get_color_frame=object)
    with emulated(scene) as (camera, _):
        monkeypatch.setattr(camera, "_wait", lambda session, expired: half)
        with pytest.raises(CameraError, match="only one of depth and colour arrives"):
            camera.capture(deadline=0.0)


def test_frames_that_do_not_say_when_they_were_exposed(scene: Scene) -> None:
    # On kernels without metadata the stamp is that of the arrival: the latency is assumed.
    with emulated(scene) as (camera, source):
        source.domain = "system_time"
        scene.color = np.full_like(scene.color, 5)
        called = time.time()
        frame = camera.capture()
        assert (frame.color == 5).all()
        assert called <= frame.captured_at


def test_a_camera_that_wakes_up_on_reset_is_reset(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tdpg_deploy.drivers.realsense.FIRST_FRAME_LIMIT", 0.3)
    source = EmulatedD435(scene.frame, heals_on_reset=True)
    source.fault = stalled
    camera = RealsenseCamera(section(), clock=MachineClock(), source=source, warm_up=0.0)
    camera.connect()
    assert source.resets == 1
    assert camera.capture().sequence == 1
    camera.close()


def test_constructing_opens_nothing_and_closing_leaves_nothing(scene: Scene) -> None:
    threads = threading.active_count()
    source = EmulatedD435(scene.frame)
    camera = RealsenseCamera(section(), clock=MachineClock(), source=source)
    camera.close()
    assert threading.active_count() == threads
    with pytest.raises(DeviceUnreachable, match=r"not connected; call connect\(\)"):
        camera.capture()
    with pytest.raises(DeviceUnreachable, match="not connected"):
        assert camera.intrinsics
    with emulated(scene) as (connected, _):
        connected.connect()  # again: nothing happens
    connected.close()
    assert threading.active_count() == threads
