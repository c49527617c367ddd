"""An Intel RealSense D435 as `hal.Camera`: depth aligned to colour, metres, fresh frames only."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tdpg_deploy.averaging import mean_depth
from tdpg_deploy.cell_config import CameraSection
from tdpg_deploy.drivers.realsense_frames import (
    Depth,
    depth_in_metres,
    same_camera,
    to_intrinsics,
)
from tdpg_deploy.drivers.realsense_library import load_realsense
from tdpg_deploy.drivers.realsense_source import (
    RealsenseSource,
    Recording,
    StreamFormat,
    UsbCamera,
)
from tdpg_deploy.errors import CameraError, DeviceTimeout, DeviceUnreachable
from tdpg_deploy.hal import Clock, Intrinsics, RgbdFrame

WARM_UP = 1.0  # s; auto exposure settles within about 30 frames
FIRST_FRAME_LIMIT = 5.0  # s of real time from the start of the streams
ARRIVAL_LATENCY = 0.1  # s; from exposure to the host at most, for cameras that do not say
SILENT_PERIODS = 3  # without a frame: the stream has ceased
PATIENCE_MS = 50  # of real time in one wait, between looks at the clock


@dataclass(frozen=True, kw_only=True)
class _Session:
    """What lives from connect to close, of pyrealsense2's types. align: None where depth and
    colour share one camera."""

    pipeline: Any
    device: Any
    serial: str
    intrinsics: Intrinsics
    align: Any
    filters: tuple[Any, ...]


class RealsenseCamera:
    """`hal.Camera`. The frames come from USB or from `section.recording`, unless a `source` is
    given (an emulated camera). Recordings are played from their beginning, each frame once."""

    def __init__(
        self,
        section: CameraSection,
        *,
        clock: Clock,
        source: RealsenseSource | None = None,
        warm_up: float = WARM_UP,
    ) -> None:
        self._section = section
        self._clock = clock
        self._source = source or _source(section)
        self._warm_up = warm_up
        self._session: _Session | None = None
        self._sequence = 0

    @property
    def intrinsics(self) -> Intrinsics:
        return self._connected().intrinsics

    @property
    def device(self) -> Any:
        """The pyrealsense2 device (for diagnosis)."""
        return self._connected().device

    def connect(self) -> None:
        """Start the streams and let the exposure settle. Raises DeviceUnreachable without a
        camera, CameraError or DeviceTimeout when it delivers nothing, even after a reset."""
        if self._session is not None:
            return
        try:
            self._start()
        except (CameraError, DeviceTimeout):
            self._source.reset()
            self._start()

    def close(self) -> None:
        if self._session is not None:
            session, self._session = self._session, None
            self._source.stop(session.pipeline)

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        """Depth is the mean over `frames_averaged` frames; colour and time are the last one's.

        Raises DeviceTimeout when no frames arrive, CameraError when only stale, torn or blind
        ones do, DeviceUnreachable when the camera is gone.
        """
        session = self._connected()
        began = time.time()
        end = self._clock.now() + deadline
        depths: list[Depth] = []
        while len(depths) < self._section.frames_averaged:
            frames = self._next_fresh(session, began, end)
            pair = _aligned(session, frames)
            depth = pair.get_depth_frame()
            depths.append(depth_in_metres(np.asanyarray(depth.get_data()), depth.get_units()))
        mean = mean_depth(depths)
        if np.isnan(mean).all():
            raise CameraError(
                f"{self._source.name}: no pixel has depth; is the lens covered, or all closer "
                "than 0.2 m?"
            )
        self._sequence += 1
        age = self._age(frames)
        return RgbdFrame(
            # Copied: librealsense stalls once some fifteen of its frames are kept.
            color=np.array(pair.get_color_frame().get_data()),
            depth=mean,
            intrinsics=session.intrinsics,
            captured_at=self._clock.now() - age,
            sequence=self._sequence,
            serial=session.serial,
        )

    # --- starting -----------------------------------------------------------------------------

    def _start(self) -> None:
        rs = load_realsense()
        section = self._section
        wanted = StreamFormat(width=section.width, height=section.height, fps=section.fps)
        pipeline, profile = self._source.start(wanted)
        try:
            self._session = self._begin(rs, pipeline, profile, wanted)
            if self._source.is_live:
                self._set_options(rs, self._session.device)
                self._settle(self._session)
        except BaseException as error:
            self._session = None
            self._source.stop(pipeline)
            if isinstance(error, RuntimeError):  # librealsense's own
                raise CameraError(f"{self._source.name}: cannot be set up ({error})") from error
            raise

    def _begin(self, rs: Any, pipeline: Any, profile: Any, wanted: StreamFormat) -> _Session:
        depth, color = (
            profile.get_stream(kind).as_video_stream_profile()
            for kind in (rs.stream.depth, rs.stream.color)
        )
        intrinsics = to_intrinsics(color.get_intrinsics())
        if (intrinsics.width, intrinsics.height) != (wanted.width, wanted.height):
            raise CameraError(
                f"{self._source.name}: colour is {intrinsics.width}x{intrinsics.height}, the cell "
                f"file says {wanted.width}x{wanted.height}: set camera.width"
            )
        device = profile.get_device()
        return _Session(
            pipeline=pipeline,
            device=device,
            serial=self._identified(device.get_info(rs.camera_info.serial_number)),
            intrinsics=intrinsics,
            align=None if same_camera(depth, color) else rs.align(rs.stream.color),
            filters=tuple(_filter(rs, name) for name in self._section.filters),
        )

    def _identified(self, serial: str) -> str:
        if self._section.serial not in (None, serial):
            raise DeviceUnreachable(
                f"{self._source.name} is camera {serial}, the cell file wants "
                f"{self._section.serial}; its calibration would be wrong"
            )
        return serial

    def _set_options(self, rs: Any, device: Any) -> None:
        options = {rs.option.emitter_enabled: float(self._section.emitter)}
        if self._section.preset is not None:
            preset = getattr(rs.rs400_visual_preset, self._section.preset.replace(" ", "_"))
            options[rs.option.visual_preset] = float(preset.value)
        sensor = device.first_depth_sensor()
        for option, value in options.items():
            sensor.set_option(option, value)

    def _settle(self, session: _Session) -> None:
        """Let the exposure settle; also proves that frames arrive."""
        self._wait(session, _after(FIRST_FRAME_LIMIT))
        settled = _after(self._warm_up)
        while not settled():
            self._wait(session, _after(FIRST_FRAME_LIMIT))

    # --- frames -------------------------------------------------------------------------------

    def _next_fresh(self, session: _Session, began: float, end: float) -> Any:
        """A pair exposed after `began` (host time)."""
        complaint, heard = "", -math.inf
        while True:
            try:
                frames = self._wait(session, lambda: self._clock.now() >= end)
            except DeviceTimeout:
                if self._clock.now() - heard < SILENT_PERIODS / self._section.fps:
                    raise CameraError(complaint) from None
                raise  # whatever was wrong with the last frame, none came after it
            heard = self._clock.now()
            if not (complaint := self._flaw(frames, began)):
                return frames
            if self._clock.now() >= end:
                raise CameraError(complaint)

    def _wait(self, session: _Session, expired: Callable[[], bool]) -> Any:
        """The next frames, whatever they are."""
        while True:
            try:
                arrived, frames = session.pipeline.try_wait_for_frames(PATIENCE_MS)
            except RuntimeError as error:
                raise DeviceUnreachable(
                    f"{self._source.name}: lost ({error}); check cable and port, connect again"
                ) from error
            if arrived:
                return frames
            if _has_ended(session):
                raise CameraError(f"{self._source.name}: has been played to its end")
            if expired():
                raise DeviceTimeout(
                    f"{self._source.name}: no frame before the deadline; is it plugged in? "
                    "Close and connect again: that resets it"
                )

    def _flaw(self, frames: Any, began: float) -> str:
        """What is wrong with this pair, or nothing."""
        depth, color = frames.get_depth_frame(), frames.get_color_frame()
        if not depth or not color:
            return f"{self._source.name}: only one of depth and colour arrives; reconnect it"
        apart = abs(depth.get_timestamp() - color.get_timestamp()) * 1e-3
        # The sensors run freely: nearest frames lie up to half a period apart, others a whole.
        if apart > 0.75 / self._section.fps:
            return (
                f"{self._source.name}: depth and colour are {apart:.3f} s apart; one of them has "
                "ceased or the bus is overloaded: connect again, at a lower rate or another port"
            )
        age = self._age(frames)
        if self._source.is_live and age > min(time.time() - began, self._section.max_frame_age):
            return (
                f"{self._source.name}: its newest frame is {age:.3f} s old, exposed before it was "
                "asked for; the camera hangs: close and connect again"
            )
        return ""

    def _age(self, frames: Any) -> float:
        """Seconds since the earlier one of the pair was exposed, by the host's clock."""
        if not self._source.is_live:
            return 0.0
        pair = (frames.get_depth_frame(), frames.get_color_frame())
        if any(f.get_frame_timestamp_domain().name != "global_time" for f in pair):
            return ARRIVAL_LATENCY
        return time.time() - min(float(f.get_timestamp()) for f in pair) * 1e-3

    def _connected(self) -> _Session:
        if self._session is None:
            raise DeviceUnreachable(f"{self._source.name}: not connected; call connect() first")
        return self._session


def _aligned(session: _Session, frames: Any) -> Any:
    """Filtered, and depth as the colour camera sees it."""
    for step in session.filters:
        frames = step.process(frames).as_frameset()
    # rs.align leaves holes even where there is nothing to align.
    return frames if session.align is None else session.align.process(frames)


def _has_ended(session: _Session) -> bool:
    playback = session.device.as_playback()
    return bool(playback) and playback.current_status().name == "stopped"


def _source(section: CameraSection) -> RealsenseSource:
    if section.recording is not None:
        return Recording(Path(section.recording))
    return UsbCamera(section.serial)


def _filter(rs: Any, name: str) -> Any:
    return {
        "spatial": rs.spatial_filter,
        "temporal": rs.temporal_filter,
        "hole filling": rs.hole_filling_filter,
    }[name]()


def _after(seconds: float) -> Callable[[], bool]:
    end = time.monotonic() + seconds
    return lambda: time.monotonic() >= end
