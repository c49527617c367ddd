"""Is the camera there, fast enough, and does it see the table where the cell file has it?"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.doctor.calibration import examine_calibration
from tdpg_deploy.doctor.finding import Finding, judge
from tdpg_deploy.drivers.realsense import RealsenseCamera
from tdpg_deploy.drivers.realsense_library import load_realsense
from tdpg_deploy.hal import RgbdFrame
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.workspace import workspace_of

CAMERA = "camera"
FRAMES = 15
ENOUGH_SEEN, TOO_LITTLE_SEEN = 0.90, 0.60  # of the workspace's square
TABLE_GOOD, TABLE_BAD = 0.006, 0.015  # m from where the cell file has it
SUBPIXEL = 0.1  # pixels of disparity, one sigma: the worse end of what a D435 does
BASELINE = 0.050  # m, D435 datasheet
DEPTH_FX_SHARE = 0.70  # of the colour camera's focal length, in pixels at the same width


def examine_camera(camera: RealsenseCamera, config: CellConfig) -> Iterator[Finding]:
    """Findings, or DeviceError when it does not deliver. Connects, looks, closes."""
    camera.connect()
    try:
        yield from _device(camera)
        frames, rate = _watch(camera)
    finally:
        camera.close()
    wanted = config.camera.fps / config.camera.frames_averaged
    yield judge_rate(rate, wanted)
    depths = np.stack([frame.depth for frame in frames])
    yield judge_noise(depths, frames[0].intrinsics.fx)
    yield from _table(frames[-1], config)
    yield from examine_calibration(config.camera.calibration, frames[-1])


def _device(camera: RealsenseCamera) -> Iterator[Finding]:
    rs = load_realsense()

    def told(key: str) -> str:
        info = getattr(rs.camera_info, key)
        return str(camera.device.get_info(info)) if camera.device.supports(info) else "unknown"

    yield judge(
        CAMERA,
        "device",
        f"{told('name')}, serial {told('serial_number')}, pyrealsense2 {rs.__version__}",
        good=True,
        remedy="",
    )
    firmware, recommended = told("firmware_version"), told("recommended_firmware_version")
    yield judge(
        CAMERA,
        "firmware",
        firmware,
        good=recommended in ("unknown", firmware),
        remedy=f"this librealsense was tested with {recommended}: rs-fw-update",
    )
    usb = told("usb_type_descriptor")
    yield judge(
        CAMERA,
        "usb",
        f"USB {usb}",
        good=usb[:1] in ("3", "u"),
        bad=True,
        remedy="use a USB 3 port and cable: USB 2 cannot carry both streams",
    )


def _watch(camera: RealsenseCamera) -> tuple[list[RgbdFrame], float]:
    """Some frames, and how many came a second."""
    began = time.monotonic()
    frames = [camera.capture() for _ in range(FRAMES)]
    return frames, FRAMES / (time.monotonic() - began)


def judge_rate(rate: float, wanted: float) -> Finding:
    # Every look waits for a frame that is exposed after it began: half of all frames suffice.
    return judge(
        CAMERA,
        "rate",
        f"{rate:.1f} fresh frames a second of {wanted:.0f}",
        good=rate > 0.4 * wanted,
        remedy="the host or the bus is too slow: lower camera.fps or camera.width",
    )


def judge_noise(depths: npt.NDArray[np.float32], fx: float) -> Finding:
    """depths: (N, H, W) of a still scene, metres. fx of the colour camera, pixels."""
    still = np.isfinite(depths).all(axis=0)
    if not still.any():
        measured, good = "no pixel is seen in every frame", False
    else:
        seen = depths[:, still]
        distance = float(np.median(seen))
        noise = float(np.median(seen.std(axis=0)))
        expected = distance**2 * SUBPIXEL / (DEPTH_FX_SHARE * fx * BASELINE)
        measured = f"{noise * 1e3:.2f} mm at {distance:.2f} m (a D435: {expected * 1e3:.2f} mm)"
        good = noise < 2 * expected
    return judge(
        CAMERA,
        "noise",
        measured,
        good=good,
        remedy='more light or texture, camera.emitter = true, camera.preset = "high accuracy"',
    )


def _table(frame: RgbdFrame, config: CellConfig) -> Iterator[Finding]:
    heightmap = build_heightmap(frame, config.X_base_camera, workspace_of(config))
    yield from judge_table(heightmap.height)


def judge_table(height: npt.NDArray[np.float32]) -> Iterator[Finding]:
    """height: (224, 224) metres above where the cell file has the table, nan where unseen."""
    seen = float(np.isfinite(height).mean())
    yield judge(
        CAMERA,
        "workspace seen",
        f"{seen:.0%} of the square has depth",
        good=seen >= ENOUGH_SEEN,
        bad=seen < TOO_LITTLE_SEEN,
        remedy="aim the camera at workspace.center; shiny or dark tables want another cover",
    )
    if seen:
        # Objects stand on the table: the lower quarter of the square is surely table.
        offset = float(np.nanpercentile(height, 25))
        yield judge(
            CAMERA,
            "table",
            f"{offset * 1e3:+.1f} mm above workspace.table_z",
            good=abs(offset) <= TABLE_GOOD,
            bad=abs(offset) > TABLE_BAD,
            remedy="measure workspace.table_z, or calibrate camera.X_base_camera anew",
        )
