"""Frames of a simulated camera through TCP, to an EmulatedD435 in another process.

A connection carries one frame: a line of JSON, then colour and depth, row by row; then the
server closes it.
"""

from __future__ import annotations

import json
import socket
import time
from dataclasses import asdict

import numpy as np

from tdpg_deploy.errors import CameraError, DeviceTimeout, DeviceUnreachable
from tdpg_deploy.hal import Intrinsics, RgbdFrame

DEADLINE = 2.0  # s for a frame


def encode(frame: RgbdFrame, *, ages: tuple[float, float] = (0.0, 0.0)) -> bytes:
    """ages: s since its colour and its depth were exposed."""
    header = {
        "ages": ages,
        "intrinsics": asdict(frame.intrinsics),
        "captured_at": frame.captured_at,
        "sequence": frame.sequence,
        "serial": frame.serial,
    }
    pixels = frame.color.tobytes() + frame.depth.astype("<f4", copy=False).tobytes()
    return json.dumps(header).encode() + b"\n" + pixels


def decode(message: bytes) -> tuple[RgbdFrame, tuple[float, float]]:
    """A frame, and the ages of its colour and depth, s. Raises CameraError for what is not a
    whole frame."""
    line, _, pixels = message.partition(b"\n")
    try:
        header = json.loads(line)
        color_age, depth_age = map(float, header.pop("ages"))
        distortion = tuple(header["intrinsics"].pop("distortion"))
        intrinsics = Intrinsics(**header.pop("intrinsics"), distortion=distortion)
        shape = (intrinsics.height, intrinsics.width)
        count = intrinsics.height * intrinsics.width
        color = np.frombuffer(pixels, np.uint8, 3 * count).reshape(*shape, 3)
        depth = np.frombuffer(pixels, "<f4", count, 3 * count).reshape(shape)
        frame = RgbdFrame(color=color, depth=depth, intrinsics=intrinsics, **header)
        return frame, (color_age, depth_age)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CameraError(
            f"{len(message)} bytes that are not a frame ({error}): is camera.emulated the address "
            "of a tdpg-emulate of this version?"
        ) from error


class RemoteFrames:
    """What the camera of an emulated cell sees now, each time it is called.

    ages: of the last frame's colour and depth when it was sent, s.
    """

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self.ages = (0.0, 0.0)

    def __call__(self) -> RgbdFrame:
        """Raises DeviceUnreachable, DeviceTimeout or CameraError."""
        frame, self.ages = decode(self._receive())
        return frame

    def _receive(self) -> bytes:
        name = "the emulated camera at {}:{}".format(*self._address)
        end = time.monotonic() + DEADLINE
        received = bytearray()
        try:
            with socket.create_connection(self._address, DEADLINE) as connection:
                while chunk := connection.recv(1 << 20):
                    received += chunk
                    connection.settimeout(max(end - time.monotonic(), 1e-3))
        except TimeoutError as error:
            raise DeviceTimeout(
                f"{name} gave no frame within {DEADLINE:.0f} s: it hangs, or its machine is busy"
            ) from error
        except OSError as error:
            raise DeviceUnreachable(
                f"{name} cannot be reached ({error.strerror}): is tdpg-emulate running, is "
                "camera.emulated what it printed?"
            ) from error
        return bytes(received)
