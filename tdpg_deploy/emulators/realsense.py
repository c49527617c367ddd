"""A D435 without a camera: librealsense's software device, fed by any source of frames.

    camera = RealsenseCamera(section, clock=clock, source=EmulatedD435(frames))

runs librealsense's own pipeline, syncer, alignment and filters on what `frames()` returns.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from tdpg_deploy.drivers.realsense_library import load_realsense
from tdpg_deploy.drivers.realsense_source import StreamFormat
from tdpg_deploy.errors import CameraError, DeviceError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Intrinsics, RgbdFrame

DEPTH_UNITS = 0.001  # m a count, as a D435 leaves the factory
BASELINE_MM = 50.0
STOP_LIMIT = 5.0  # s
EMULATED_SERIAL = "000000000000"


@dataclass(frozen=True, kw_only=True, eq=False)
class Exposure:
    """One pair on its way out. color: (H, W, 3) uint8. counts: (H, W) uint16 of DEPTH_UNITS, 0
    where unknown; None when it does not come. Times in seconds since the UNIX epoch, by this
    machine's clock."""

    color: npt.NDArray[np.uint8]
    counts: npt.NDArray[np.uint16] | None
    color_at: float
    depth_at: float


Fault: TypeAlias = Callable[[Exposure], "Exposure | None"]
"""What happens to a pair before it is delivered; None loses it."""


def healthy(exposure: Exposure) -> Exposure:
    return exposure


def stalled(_exposure: Exposure) -> None:
    """No frame comes any more."""


def stale(seconds: float) -> Fault:
    """Frames were exposed long before they come."""
    return lambda e: replace(e, color_at=e.color_at - seconds, depth_at=e.depth_at - seconds)


def arriving_late(ages: Callable[[], tuple[float, float]]) -> Fault:
    """Colour and depth are so many seconds old, each time asked anew."""

    def late(e: Exposure) -> Exposure:
        color_age, depth_age = ages()
        return replace(e, color_at=e.color_at - color_age, depth_at=e.depth_at - depth_age)

    return late


def torn(seconds: float) -> Fault:
    """Colour was exposed before the depth that comes with it."""
    return lambda e: replace(e, color_at=e.color_at - seconds)


def holes(share: float) -> Fault:
    """The left `share` of the picture has no depth."""

    def blind(exposure: Exposure) -> Exposure:
        assert exposure.counts is not None
        counts = exposure.counts.copy()
        counts[:, : round(share * counts.shape[1])] = 0
        return replace(exposure, counts=counts)

    return blind


def depth_lost(exposure: Exposure) -> Exposure:
    """Colour comes alone."""
    return replace(exposure, counts=None)


def first_exposures(count: int, faulty: Fault) -> Fault:
    """Faulty for the first `count` pairs, then healthy."""
    left = itertools.count(count, -1)
    return lambda exposure: faulty(exposure) if next(left) > 0 else exposure


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthCamera:
    """A depth camera apart from the colour camera, as on the real device."""

    intrinsics: Intrinsics
    X_color_depth: Transform


class EmulatedD435:
    """A `RealsenseSource`. `frames` gives what the camera sees now, as often as the rate asks;
    it is called from a thread of its own.

    Its depth is that of the colour camera, unless a `depth_camera` says that it is another's.
    `fault` may be changed at any time. `reset` cures it when `heals_on_reset`.
    """

    is_live = True

    def __init__(
        self,
        frames: Callable[[], RgbdFrame],
        *,
        serial: str = EMULATED_SERIAL,
        depth_camera: DepthCamera | None = None,
        heals_on_reset: bool = False,
    ) -> None:
        self._frames = frames
        self._serial = serial
        self._depth_camera = depth_camera
        self._heals_on_reset = heals_on_reset
        self.delivered = 0
        self._running = threading.Event()
        self._feeder: threading.Thread | None = None
        self.fault: Fault = healthy
        self.domain = "global_time"  # whose clock stamps the frames: rs.timestamp_domain
        self.resets = 0

    @property
    def name(self) -> str:
        return f"emulated camera {self._serial}"

    def start(self, wanted: StreamFormat) -> tuple[Any, Any]:
        seen = self._frames().intrinsics
        if (seen.width, seen.height) != (wanted.width, wanted.height):
            raise CameraError(
                f"{self.name}: shows {seen.width}x{seen.height}, asked for "
                f"{wanted.width}x{wanted.height}; make the source and camera.width agree"
            )
        rs = load_realsense()
        depth_camera = self._depth_camera or DepthCamera(
            intrinsics=seen, X_color_depth=Transform.identity()
        )
        self._device = SoftwareD435(rs, self._serial, seen, depth_camera, wanted.fps)
        self._pipeline = pipeline = rs.pipeline(rs.context())
        pipeline.set_device(self._device.device)
        config = rs.config()
        config.enable_stream(rs.stream.depth, rs.format.z16, wanted.fps)
        config.enable_stream(rs.stream.color, rs.format.rgb8, wanted.fps)
        profile = pipeline.start(config)
        self._running.set()
        self._feeder = threading.Thread(target=self._feed, args=(1 / wanted.fps,), daemon=True)
        self._feeder.start()
        return pipeline, profile

    def stop(self, pipeline: Any) -> None:
        self._running.clear()
        if self._feeder is not None:
            self._feeder.join(STOP_LIMIT)
            self._feeder = None
        with contextlib.suppress(RuntimeError):  # unplugged
            pipeline.stop()

    def reset(self) -> None:
        self.resets += 1
        if self._heals_on_reset:
            self.fault = healthy

    def unplug(self) -> None:
        """The pipeline breaks, as when the cable is pulled."""
        self._pipeline.stop()

    def _feed(self, period: float) -> None:
        due = time.monotonic()
        while self._running.is_set():
            try:
                exposure = self.fault(self._expose())
            except DeviceError:
                exposure = None  # the source hangs or is gone; it may come back
            if exposure is not None:
                self.delivered += 1
                self._device.deliver(exposure, self.delivered, self.domain)
            due = max(due + period, time.monotonic())  # a late source loses frames, not time
            time.sleep(max(0.0, due - time.monotonic()))

    def _expose(self) -> Exposure:
        now = time.time()
        frame = self._frames()
        counts = np.nan_to_num(frame.depth / np.float32(DEPTH_UNITS)).round().astype(np.uint16)
        return Exposure(color=frame.color, counts=counts, color_at=now, depth_at=now)


class SoftwareD435:
    """librealsense's software device with a D435's two sensors."""

    def __init__(
        self, rs: Any, serial: str, color: Intrinsics, depth: DepthCamera, fps: int
    ) -> None:
        self._rs = rs
        self.device = rs.software_device()
        for key, value in (
            (rs.camera_info.name, "Intel RealSense D435 (emulated)"),
            (rs.camera_info.serial_number, serial),
            (rs.camera_info.firmware_version, "5.16.0.1"),
            (rs.camera_info.usb_type_descriptor, "3.2"),
        ):
            self.device.register_info(key, value)
        self._depth_sensor = self.device.add_sensor("Stereo Module")
        self._color_sensor = self.device.add_sensor("RGB Camera")
        self._depth_sensor.add_read_only_option(rs.option.depth_units, DEPTH_UNITS)
        self._depth_sensor.add_read_only_option(rs.option.stereo_baseline, BASELINE_MM)
        self._depth_sensor.add_option(rs.option.emitter_enabled, _range(rs, 2), True)
        self._depth_sensor.add_option(rs.option.visual_preset, _range(rs, 6), True)
        self._depth_profile = self._depth_sensor.add_video_stream(
            _stream(rs, rs.stream.depth, rs.format.z16, 2, depth.intrinsics, fps), True
        )
        self._color_profile = self._color_sensor.add_video_stream(
            _stream(rs, rs.stream.color, rs.format.rgb8, 3, color, fps), True
        )
        extrinsics = rs.extrinsics()
        # Rotations are stored column by column.
        extrinsics.rotation = depth.X_color_depth.rotation.as_matrix().T.ravel().tolist()
        extrinsics.translation = depth.X_color_depth.translation.tolist()
        self._depth_profile.register_extrinsics_to(self._color_profile, extrinsics)
        self.device.create_matcher(rs.matchers.default)

    def deliver(self, exposure: Exposure, number: int, domain: str = "global_time") -> None:
        self._domain = getattr(self._rs.timestamp_domain, domain)
        if exposure.counts is not None:
            depth = self._frame(self._depth_profile, exposure.counts, exposure.depth_at, number)
            depth.depth_units = DEPTH_UNITS
            self._depth_sensor.on_video_frame(depth)
        color = self._frame(self._color_profile, exposure.color, exposure.color_at, number)
        self._color_sensor.on_video_frame(color)

    def _frame(self, profile: Any, pixels: npt.NDArray[Any], at: float, number: int) -> Any:
        video = profile.as_video_stream_profile()
        # librealsense copies as many bytes as the profile says, whatever the array holds.
        assert pixels.shape[:2] == (video.height(), video.width())
        frame = self._rs.software_video_frame()
        frame.pixels = np.ascontiguousarray(pixels)
        frame.bpp = pixels[0, 0].nbytes
        frame.stride = frame.bpp * pixels.shape[1]
        frame.timestamp = at * 1e3
        frame.domain = self._domain
        frame.frame_number = number
        frame.profile = video
        return frame


def _stream(
    rs: Any, kind: Any, pixel_format: Any, bpp: int, intrinsics: Intrinsics, fps: int
) -> Any:
    model = rs.intrinsics()
    model.width, model.height = intrinsics.width, intrinsics.height
    model.fx, model.fy = intrinsics.fx, intrinsics.fy
    model.ppx, model.ppy = intrinsics.cx, intrinsics.cy
    model.model = rs.distortion.brown_conrady
    model.coeffs = list(intrinsics.distortion)
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid = kind, 0, int(kind)
    stream.width, stream.height, stream.fps = intrinsics.width, intrinsics.height, fps
    stream.bpp, stream.fmt, stream.intrinsics = bpp, pixel_format, model
    return stream


def _range(rs: Any, largest: int) -> Any:
    span = rs.option_range()
    span.min, span.max, span.default, span.step = 0, largest, 0, 1
    return span
