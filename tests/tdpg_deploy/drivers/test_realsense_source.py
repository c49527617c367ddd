"""Where frames come from: the library itself, cameras on a stubbed USB, recordings."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from emulated_d435 import Scene, section

from tdpg_deploy.cell import MachineClock
from tdpg_deploy.drivers import realsense_source
from tdpg_deploy.drivers.realsense import RealsenseCamera
from tdpg_deploy.drivers.realsense_library import load_realsense
from tdpg_deploy.drivers.realsense_source import Recording, StreamFormat, UsbCamera
from tdpg_deploy.emulators.realsense import DEPTH_UNITS, DepthCamera, Exposure, SoftwareD435
from tdpg_deploy.errors import CameraError, DeviceTimeout, DeviceUnreachable
from tdpg_deploy.geometry import Transform

VGA = StreamFormat(width=640, height=480, fps=30)
FRAMES = 8


# --- the library ------------------------------------------------------------------------------


def test_the_librarys_own_libusb_serves_where_the_system_has_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loaded: list[tuple[str, int]] = []
    cdll = ctypes.CDLL

    def load(name: str, mode: int = 0) -> ctypes.CDLL:
        if name == "libusb-1.0.so.0":
            raise OSError("not there")
        loaded.append((name, mode))
        return cdll(name, mode)

    monkeypatch.setattr(ctypes, "CDLL", load)
    assert load_realsense().__name__ == "pyrealsense2"
    ((name, mode),) = loaded
    assert "libusb_package" in name
    assert mode == ctypes.RTLD_GLOBAL


def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(DeviceUnreachable, match=r"pip install 'tdpg-deploy\[real\]'"):
        load_realsense()


# --- USB --------------------------------------------------------------------------------------


class Bus:
    """A stub of pyrealsense2 with cameras on its bus; `listings` are what it lists in turn."""

    def __init__(self, *listings: list[str], refuses: str = "") -> None:
        self.listings = list(listings)
        self.refuses = refuses
        self.enabled: list[Any] = []
        self.resets: list[str] = []
        self.camera_info = SimpleNamespace(serial_number="serial_number")
        self.stream = SimpleNamespace(depth="depth", color="color")
        self.format = SimpleNamespace(z16="z16", rgb8="rgb8")

    def context(self) -> Any:
        serials = self.listings[0] if len(self.listings) == 1 else self.listings.pop(0)
        return SimpleNamespace(query_devices=lambda: [self.device(s) for s in serials])

    def device(self, serial: str) -> Any:
        return SimpleNamespace(
            get_info=lambda _: serial, hardware_reset=lambda: self.resets.append(serial)
        )

    def config(self) -> Any:
        return SimpleNamespace(
            enable_device=self.enabled.append,
            enable_stream=lambda *wanted: self.enabled.append(wanted),
        )

    def pipeline(self) -> Any:
        def start(config: Any) -> str:
            if self.refuses:
                raise RuntimeError(self.refuses)
            return "profile"

        def stop() -> None:
            raise RuntimeError("stop() cannot be called before start()")

        return SimpleNamespace(start=start, stop=stop)


def on(bus: Bus, monkeypatch: pytest.MonkeyPatch, serial: str | None = None) -> UsbCamera:
    monkeypatch.setattr(realsense_source, "load_realsense", lambda: bus)
    return UsbCamera(serial)


def test_the_camera_of_the_cell_file_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = Bus(["111", "222"])
    camera = on(bus, monkeypatch, "222")
    pipeline, profile = camera.start(VGA)
    assert profile == "profile"
    assert bus.enabled == ["222", ("depth", 640, 480, "z16", 30), ("color", 640, 480, "rgb8", 30)]
    camera.stop(pipeline)  # also when it has stopped by itself


@pytest.mark.parametrize(
    ("there", "serial", "told"),
    [
        ([], None, r"camera: not found on USB \(there: none\)"),
        (["111"], "222", r"camera 222: not found on USB \(there: 111\)"),
        (["111", "222"], None, r"several cameras on USB \(111, 222\): name one"),
    ],
)
def test_the_wrong_cameras_are_named(
    monkeypatch: pytest.MonkeyPatch, there: list[str], serial: str | None, told: str
) -> None:
    with pytest.raises(DeviceUnreachable, match=told):
        on(Bus(there), monkeypatch, serial).start(VGA)


def test_a_refused_format_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = Bus(["111"], refuses="Couldn't resolve requests")
    with pytest.raises(CameraError, match=r"640x480 at 30/s \(Couldn't resolve requests\).*USB 3"):
        on(bus, monkeypatch).start(VGA)


def test_a_reset_waits_until_the_camera_is_back(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = Bus(["111"], ["111"], [], [], ["111"])
    on(bus, monkeypatch).reset()
    assert bus.resets == ["111"]
    assert bus.listings == [["111"]]


def test_a_camera_that_never_comes_back_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realsense_source, "RESET_LIMIT", 0.3)
    with pytest.raises(DeviceTimeout, match="not back"):
        on(Bus(["111"], []), monkeypatch).reset()


def test_on_the_real_bus_of_this_machine_a_strange_camera_is_not_found() -> None:
    with pytest.raises(DeviceUnreachable, match="not found on USB"):
        UsbCamera("000000000000").start(VGA)


# --- recordings -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """FRAMES pairs, written by librealsense; the colour of pair n is n."""
    path = tmp_path_factory.mktemp("recording") / "cell.db3"
    scene, rs = Scene(), load_realsense()
    depth_camera = DepthCamera(intrinsics=scene.intrinsics, X_color_depth=Transform.identity())
    camera = SoftwareD435(rs, "111", scene.intrinsics, depth_camera, VGA.fps)
    config = rs.config()
    config.enable_record_to_file(str(path))
    config.enable_stream(rs.stream.depth, rs.format.z16, VGA.fps)
    config.enable_stream(rs.stream.color, rs.format.rgb8, VGA.fps)
    pipeline = rs.pipeline(rs.context())
    pipeline.set_device(camera.device)
    pipeline.start(config)
    counts = np.nan_to_num(scene.depth / DEPTH_UNITS).round().astype(np.uint16)
    for number in range(1, FRAMES + 1):
        at = number / VGA.fps
        color = np.full_like(scene.color, number)
        exposure = Exposure(color=color, counts=counts, color_at=at, depth_at=at)
        camera.deliver(exposure, number)
        arrived, _ = pipeline.try_wait_for_frames(2000)
        assert arrived
    pipeline.stop()
    return path


def test_a_recording_is_played_frame_by_frame_to_its_end(recording: Path) -> None:
    camera = RealsenseCamera(section(recording=str(recording)), clock=MachineClock())
    camera.connect()
    scene = Scene()
    for number in range(1, FRAMES + 1):
        frame = camera.capture()
        assert (frame.color == number).all()
        np.testing.assert_allclose(frame.depth, scene.depth, rtol=1e-6)
    with pytest.raises(CameraError, match="has been played to its end"):
        camera.capture()
    camera.close()


def test_a_recording_of_another_size_is_told(recording: Path) -> None:
    fields = section(recording=str(recording)).model_copy(update={"width": 1280})
    with pytest.raises(CameraError, match="640x480, the cell file says 1280x720"):
        RealsenseCamera(fields, clock=MachineClock()).connect()


def test_no_recording_and_no_recording_at_all(tmp_path: Path) -> None:
    with pytest.raises(DeviceUnreachable, match="there is no such file"):
        Recording(tmp_path / "none.db3").start(VGA)
    (tmp_path / "bad.db3").write_bytes(b"not a recording")
    source = Recording(tmp_path / "bad.db3")
    with pytest.raises(CameraError, match="does not start"):
        source.start(VGA)
    source.reset()
