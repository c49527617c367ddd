"""Where the frames of a RealSense pipeline come from: a camera on USB, or a recording."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from tdpg_deploy.drivers.realsense_library import load_realsense
from tdpg_deploy.errors import CameraError, DeviceTimeout, DeviceUnreachable

RESET_LIMIT = 10.0  # s from a hardware reset until the camera is on the bus again


@dataclass(frozen=True, kw_only=True)
class StreamFormat:
    """Both streams: pixels and frames a second. Depth is Z16, colour RGB8."""

    width: int
    height: int
    fps: int


class RealsenseSource(Protocol):
    """Starts pipelines. All three raise DeviceError only."""

    @property
    def name(self) -> str: ...

    @property
    def is_live(self) -> bool:
        """Frames show the present, and the camera takes options."""

    def start(self, wanted: StreamFormat) -> tuple[Any, Any]:
        """A started pyrealsense2 pipeline and its profile."""

    def stop(self, pipeline: Any) -> None: ...

    def reset(self) -> None:
        """Restart the device, and wait until it is there again."""


class UsbCamera:
    """A camera on USB: the one with this serial number, or the only one."""

    is_live = True

    def __init__(self, serial: str | None) -> None:
        self._serial = serial

    @property
    def name(self) -> str:
        return f"camera {self._serial}" if self._serial else "camera"

    def start(self, wanted: StreamFormat) -> tuple[Any, Any]:
        rs = load_realsense()
        serial = _serial(rs, self._device(rs))
        config = rs.config()
        config.enable_device(serial)
        config.enable_stream(
            rs.stream.depth, wanted.width, wanted.height, rs.format.z16, wanted.fps
        )
        config.enable_stream(
            rs.stream.color, wanted.width, wanted.height, rs.format.rgb8, wanted.fps
        )
        pipeline = rs.pipeline()
        return pipeline, _started(self.name, lambda: pipeline.start(config), wanted)

    def stop(self, pipeline: Any) -> None:
        _stopped(pipeline)

    def reset(self) -> None:
        rs = load_realsense()
        self._device(rs).hardware_reset()
        # It is still listed for an instant; then it is gone for some seconds.
        end = time.monotonic() + RESET_LIMIT
        seen_gone = False
        while time.monotonic() < end:
            there = self._devices(rs)
            seen_gone = seen_gone or not there
            if seen_gone and there:
                return
            time.sleep(0.2)
        raise DeviceTimeout(
            f"{self.name}: not back {RESET_LIMIT:.0f} s after a hardware reset; unplug it"
        )

    def _devices(self, rs: Any) -> list[Any]:
        found = list(rs.context().query_devices())
        return [d for d in found if self._serial is None or _serial(rs, d) == self._serial]

    def _device(self, rs: Any) -> Any:
        matching = self._devices(rs)
        if len(matching) == 1:
            return matching[0]
        serials = ", ".join(_serial(rs, d) for d in rs.context().query_devices()) or "none"
        if not matching:
            raise DeviceUnreachable(
                f"{self.name}: not found on USB (there: {serials}); is it plugged in, and does "
                "this user have its udev rules?"
            )
        raise DeviceUnreachable(
            f"several cameras on USB ({serials}): name one as camera.serial in the cell file"
        )


class Recording:
    """A recording played back once, frame by frame, however slowly it is asked for."""

    is_live = False

    def __init__(self, path: Path) -> None:
        self._path = path

    @property
    def name(self) -> str:
        return f"recording {self._path}"

    def start(self, wanted: StreamFormat) -> tuple[Any, Any]:
        rs = load_realsense()
        if not self._path.is_file():
            raise DeviceUnreachable(f"{self.name}: there is no such file")
        config = rs.config()
        config.enable_device_from_file(str(self._path), repeat_playback=False)
        pipeline = rs.pipeline()

        def start() -> Any:
            # Before the start: a frame that is not fetched in time would be skipped.
            device = config.resolve(rs.pipeline_wrapper(pipeline)).get_device()
            device.as_playback().set_real_time(False)
            return pipeline.start(config)

        return pipeline, _started(self.name, start, wanted)

    def stop(self, pipeline: Any) -> None:
        _stopped(pipeline)

    def reset(self) -> None:
        """Nothing to restart."""


def _serial(rs: Any, device: Any) -> str:
    return str(device.get_info(rs.camera_info.serial_number))


def _started(name: str, start: Callable[[], Any], wanted: StreamFormat) -> Any:
    try:
        return start()
    except RuntimeError as error:
        raise CameraError(
            f"{name}: does not start {wanted.width}x{wanted.height} at {wanted.fps}/s ({error}); "
            "is another program using it, is it on a USB 3 port and cable?"
        ) from error


def _stopped(pipeline: Any) -> None:
    with contextlib.suppress(RuntimeError):  # it may have stopped by itself: unplugged
        pipeline.stop()
