"""Pictures of a board, painted from its pose: for self-tests and the simulated cell."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from calibration.printing import black_rectangles, raster
from calibration.target import CharucoTarget
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

BORDER = 0.5  # squares of white paper around the board
TEXTURE = 40  # px per square
SAMPLES = 4  # per pixel and axis
INK, PAPER = 30.0, 225.0  # grey levels


def board_in_front(target: CharucoTarget, distance: float) -> Transform:
    """X_camera_board of a slightly turned board in the middle of the picture."""
    rotation = Rotation.from_rotvec([0.2, -0.1, 0.3])
    middle = np.array([*target.size, 0.0]) / 2
    return Transform(rotation, np.array([0, 0, distance]) - rotation.apply(middle))


def paint_board(
    color: npt.NDArray[np.uint8],
    target: CharucoTarget,
    X_camera_board: Transform,
    lens: Intrinsics,
    depth: npt.NDArray[np.float32] | None = None,
) -> npt.NDArray[np.uint8]:
    """A copy of `color` (H, W, 3) with the board in it, antialiased by SAMPLES^2 rays a pixel.

    depth: (H, W) metres of what `color` shows; the board hides behind what is nearer, and its
    own depth is written into this array. Nothing is nearer where depth is absent or nan.
    """
    box = _bounding_box(target, X_camera_board, lens)
    if box is None:
        return color.copy()
    x0, y0, x1, y1 = box
    fine_u = (np.arange((x1 - x0) * SAMPLES) + 0.5) / SAMPLES - 0.5 + x0
    fine_v = (np.arange((y1 - y0) * SAMPLES) + 0.5) / SAMPLES - 0.5 + y0
    x, y, z = _hit(fine_u, fine_v, X_camera_board, lens)
    texture, per_metre = _texture(target)
    border = BORDER * target.square
    grey = cv2.remap(
        texture,
        ((x + border) * per_metre - 0.5).astype(np.float32),
        ((y + border) * per_metre - 0.5).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.float32)
    width, height = target.size
    on = (x > -border) & (x < width + border) & (y > -border) & (y < height + border) & (z > 0)
    if depth is not None:
        behind = depth[y0:y1, x0:x1].repeat(SAMPLES, axis=0).repeat(SAMPLES, axis=1)
        on &= ~(behind < z - 1e-3)
        nearest = z[SAMPLES // 2 :: SAMPLES, SAMPLES // 2 :: SAMPLES]
        seen = on[SAMPLES // 2 :: SAMPLES, SAMPLES // 2 :: SAMPLES]
        depth[y0:y1, x0:x1][seen] = nearest[seen]
    shape = (x1 - x0, y1 - y0)
    share = cv2.resize(on.astype(np.float32), shape, interpolation=cv2.INTER_AREA)[..., None]
    ink = cv2.resize(grey * on, shape, interpolation=cv2.INTER_AREA)[..., None]
    painted = color.copy()
    patch = painted[y0:y1, x0:x1]
    patch[:] = np.round(patch * (1 - share) + ink).astype(np.uint8)
    return painted


def _hit(
    u: Array, v: Array, X_camera_board: Transform, lens: Intrinsics
) -> tuple[Array, Array, Array]:
    """Where the rays of pixel columns u (w,) and rows v (h,) meet the board's plane: x, y in its
    frame and depth, each (h, w)."""
    if any(lens.distortion):
        flat = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
        ideal = cv2.undistortPoints(flat, lens.as_matrix(), np.array(lens.distortion))
        ray_x, ray_y = ideal.reshape(len(v), len(u), 2).transpose(2, 0, 1)
    else:
        ray_x, ray_y = (u[None] - lens.cx) / lens.fx, (v[:, None] - lens.cy) / lens.fy
    X_board_camera = X_camera_board.inverse()
    origin = X_board_camera.translation
    R = X_board_camera.rotation.as_matrix()
    across, down, into = (R[k, 0] * ray_x + R[k, 1] * ray_y + R[k, 2] for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        z = -origin[2] / into
        return origin[0] + z * across, origin[1] + z * down, z


def _texture(target: CharucoTarget) -> tuple[npt.NDArray[np.uint8], float]:
    """Board with its border, and pixels per metre."""
    per_metre = TEXTURE / target.square
    border = BORDER * target.square
    size = (target.size[0] + 2 * border, target.size[1] + 2 * border)
    drawn = raster(black_rectangles(target) + border, size, per_metre)
    return np.where(drawn == 0, INK, PAPER).astype(np.uint8), per_metre


def _bounding_box(
    target: CharucoTarget, X_camera_board: Transform, lens: Intrinsics
) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1 of the pixels that can show the board; None if it is out of the picture."""
    border = BORDER * target.square
    width, height = target.size
    x = np.linspace(-border, width + border, 5)
    y = np.linspace(-border, height + border, 5)
    outline = np.array([[a, b, 0.0] for a in x for b in y])
    p_camera = X_camera_board @ outline
    if (p_camera[:, 2] < 0.05).any():
        return None
    pixels, _ = cv2.projectPoints(
        p_camera, np.zeros(3), np.zeros(3), lens.as_matrix(), np.array(lens.distortion)
    )
    low = np.floor(pixels.reshape(-1, 2).min(axis=0)).astype(int) - 2
    high = np.ceil(pixels.reshape(-1, 2).max(axis=0)).astype(int) + 3
    x0, y0 = np.maximum(low, 0)
    x1, y1 = np.minimum(high, [lens.width, lens.height])
    if x0 >= x1 or y0 >= y1:
        return None
    return int(x0), int(y0), int(x1), int(y1)
