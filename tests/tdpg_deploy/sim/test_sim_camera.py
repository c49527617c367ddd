from __future__ import annotations

import numpy as np
import pytest
from closed_form import Box, Plane, look

from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, Pose, load_cell
from tdpg_deploy.errors import CameraError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import RgbdFrame
from tdpg_deploy.sim.bodies import box
from tdpg_deploy.sim.camera import COLOR_640, COLOR_1280, SimCamera, as_counted
from tdpg_deploy.sim.pieces import TABLE, ConvexPiece, VisiblePiece

MOCK = load_cell(DEFAULT_CELL)
BLOCK = Box(
    size=(0.06, 0.05, 0.04),
    X_base_box=Transform.from_quaternion((0.52, 0.03, -0.13), (0, 0, 0.2, 0.98)),
)


class StillClock:
    def now(self) -> float:
        return 12.5

    def sleep(self, seconds: float) -> None:
        raise AssertionError("a camera does not wait")


class BlockOnTable:
    clock = StillClock()

    def visible(self) -> list[VisiblePiece]:
        board = ConvexPiece.from_vertices(box(9, 9, 0.1, center=(0.5, 0, -0.2)))
        block = ConvexPiece.from_vertices(box(*BLOCK.size))
        return [
            VisiblePiece(board, Transform.identity(), (200, 180, 150), TABLE),
            VisiblePiece(block, BLOCK.X_base_box, (200, 40, 40), 0),
        ]


def mock(*, width: int = 640, averaged: int = 1, **simulation: object) -> CellConfig:
    """The mock cell with another camera."""
    return MOCK.model_copy(
        update={
            "camera": MOCK.camera.model_copy(update={"width": width, "frames_averaged": averaged}),
            "simulation": MOCK.simulation.model_copy(update=simulation),
        }
    )


def capture(config: CellConfig, seed: int = 0) -> RgbdFrame:
    camera = SimCamera(BlockOnTable(), config, seed=seed)
    camera.connect()
    return camera.capture()


def test_the_lens_is_that_of_a_d435() -> None:
    """Data sheet: colour field of view 69.4 by 42.5 degrees, give or take 3."""
    horizontal = 2 * np.degrees(np.arctan(640 / COLOR_1280.fx))
    vertical = 2 * np.degrees(np.arctan(360 / COLOR_1280.fy))
    assert horizontal == pytest.approx(69.4, abs=3)
    assert vertical == pytest.approx(42.5, abs=3)


def test_the_small_picture_is_the_middle_of_the_large_one() -> None:
    """The point seen in a pixel of the small one lies where cropping and shrinking say."""
    for x, y in ((0.0, 0.0), (0.3, -0.2)):
        small = np.array([COLOR_640.fx * x + COLOR_640.cx, COLOR_640.fy * y + COLOR_640.cy])
        large = np.array([COLOR_1280.fx * x + COLOR_1280.cx, COLOR_1280.fy * y + COLOR_1280.cy])
        np.testing.assert_allclose((small + 0.5) * 1.5, large + 0.5 - (160, 0))


@pytest.mark.parametrize("width", [640, 1280])
def test_without_noise_depth_is_the_closed_form_in_whole_counts(width: int) -> None:
    frame = capture(mock(width=width, depth_noise=False))
    plane = Plane(normal=(0, 0, 1), offset=-0.15)
    true = look(plane, BLOCK, frame.intrinsics, MOCK.X_base_camera).depth
    assert (np.abs(frame.depth - true) < 0.5e-3 + 1e-5).mean() > 0.9999
    np.testing.assert_allclose(frame.depth * 1e3, np.rint(frame.depth * 1e3), atol=1e-3)
    assert frame.captured_at == 12.5


def test_the_true_pose_counts_and_not_the_calibrated_one() -> None:
    X = MOCK.X_base_camera
    lifted = Pose(
        position=(X.translation[0], X.translation[1], X.translation[2] + 0.02),
        quaternion=tuple(X.as_quaternion()),
    )
    config = mock(depth_noise=False, X_base_camera=lifted)
    frame, calibrated = capture(config), capture(mock(depth_noise=False))
    assert np.nanmedian(frame.depth - calibrated.depth) > 0.015


def test_a_seed_gives_the_same_frames_and_another_one_others() -> None:
    config = mock(depth_noise=True)
    assert np.array_equal(capture(config).depth, capture(config).depth, equal_nan=True)
    assert not np.array_equal(capture(config).depth, capture(config, 1).depth, equal_nan=True)


def test_noisy_depth_comes_in_whole_millimetres() -> None:
    """So a log keeps it in 16 bits, and exactly."""
    depth = capture(mock(depth_noise=True)).depth
    counts = np.nan_to_num(depth / np.float32(0.001)).round().astype(np.uint16)
    again = np.where(counts == 0, np.float32(np.nan), counts * np.float32(0.001))
    assert np.array_equal(depth, again, equal_nan=True)
    few = as_counted(np.array([[np.nan, 0.0002, 0.0006, 0.7004, 65.5, 65.6, np.inf]], np.float32))
    expected = np.array([[np.nan, np.nan, 0.001, 0.7, 65.5, np.nan, np.nan]], np.float32)
    np.testing.assert_allclose(few, expected, rtol=1e-6)


def test_frames_differ_and_averaging_steadies_them() -> None:
    """By about the root of their number, away from edges."""
    true = capture(mock(depth_noise=False)).depth
    flat = np.s_[20:100, 200:400]

    def spread(averaged: int) -> float:
        frame = capture(mock(averaged=averaged))
        return float(np.nanstd((frame.depth - true)[flat]))

    assert spread(9) == pytest.approx(spread(1) / 3, rel=0.35)


def test_an_unconnected_camera_says_so() -> None:
    camera = SimCamera(BlockOnTable(), mock())
    with pytest.raises(CameraError, match="call connect"):
        camera.capture()
    camera.connect()
    assert camera.capture().sequence < camera.capture().sequence
    camera.close()
    with pytest.raises(CameraError, match="call connect"):
        camera.capture()
