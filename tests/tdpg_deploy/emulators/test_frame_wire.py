from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tdpg_deploy.emulators import frame_wire
from tdpg_deploy.emulators.frame_wire import RemoteFrames, decode, encode
from tdpg_deploy.errors import CameraError, DeviceTimeout, DeviceUnreachable
from tdpg_deploy.hal import Intrinsics, RgbdFrame

INTRINSICS = Intrinsics(
    width=4, height=3, fx=5.5, fy=5.25, cx=1.5, cy=1.0, distortion=(0.1, -0.2, 0.0, 1e-9, 0.3)
)


def frame() -> RgbdFrame:
    """Every pixel another; one unknown."""
    depth = np.linspace(0.3, 1.2, 12, dtype=np.float32).reshape(3, 4)
    depth[1, 2] = np.nan
    return RgbdFrame(
        color=np.arange(36, dtype=np.uint8).reshape(3, 4, 3),
        depth=depth,
        intrinsics=INTRINSICS,
        captured_at=12.5,
        sequence=7,
        serial="simulated",
    )


@contextmanager
def server(message: bytes | None) -> Iterator[RemoteFrames]:
    """Answers its only client with `message`; None: with nothing, and keeps the line."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        over = threading.Event()

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                if message is None:
                    over.wait(10.0)
                else:
                    connection.sendall(message)

        thread = threading.Thread(target=serve)
        thread.start()
        yield RemoteFrames(*listener.getsockname())
        over.set()
        thread.join()


def test_a_frame_comes_as_it_was_sent() -> None:
    sent = frame()
    with server(encode(sent, ages=(0.25, 0.5))) as frames:
        got = frames()
        assert frames.ages == (0.25, 0.5)
    assert np.array_equal(got.color, sent.color)
    assert np.array_equal(got.depth, sent.depth, equal_nan=True)
    assert got.color[2, 3].tolist() == [33, 34, 35]
    assert got.intrinsics == INTRINSICS
    assert (got.captured_at, got.sequence, got.serial) == (12.5, 7, "simulated")


@pytest.mark.parametrize(
    "message", [b"", b"\n", b"[]\n", b"{}\n" + bytes(84), b"\x80\xff\n", encode(frame())[:-1]]
)
def test_what_is_no_frame_is_refused(message: bytes) -> None:
    with pytest.raises(CameraError, match="not a frame"):
        decode(message)


def test_nobody_there() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = listener.getsockname()
    with pytest.raises(DeviceUnreachable, match="is tdpg-emulate running"):
        RemoteFrames(*address)()


def test_a_camera_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_wire, "DEADLINE", 0.2)
    with server(None) as frames, pytest.raises(DeviceTimeout, match="no frame within"):
        frames()
