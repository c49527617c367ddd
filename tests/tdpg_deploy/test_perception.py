from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from closed_form import BOX_RGB, HD, VGA, Box, Plane, frame_of, look, look_along, looking_at
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial.transform import Rotation

from policies.heightmap import INSIDE, PIXEL, RIM, SIZE, Heightmap
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.errors import FrameError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics, RgbdFrame
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.workspace import workspace_of

MOCK = load_cell(DEFAULT_CELL)
WORKSPACE = workspace_of(MOCK)
X_BASE_CAMERA = MOCK.X_base_camera
TABLE = Plane(normal=(0, 0, 1), offset=WORKSPACE.table_z)
DISTORTION = (0.12, -0.25, 0.0008, -0.0005, 0.08)

camera_poses = st.builds(
    looking_at,
    st.tuples(st.floats(0.65, 1.0), st.floats(-0.3, 0.3), st.floats(0.35, 0.75)),
    st.tuples(st.floats(0.45, 0.55), st.floats(-0.05, 0.05), st.just(WORKSPACE.table_z)),
)


def centers() -> tuple[Array, Array]:
    """x, y of all pixels' centres, from the corner that pixel (0, 0) has."""
    step = (np.arange(SIZE) + 0.5) * 0.448 / SIZE
    x, y = np.meshgrid(WORKSPACE.x_max - step, WORKSPACE.y_max - step, indexing="ij")
    return x, y


def box_at(x: float, y: float, yaw: float, size: tuple[float, float, float]) -> Box:
    z = WORKSPACE.table_z + size[2] / 2
    return Box(
        size=size,
        X_base_box=Transform(Rotation.from_euler("z", yaw), np.array([x, y, z])),
    )


def test_the_workspace_is_the_cell_files_square() -> None:
    corner = (WORKSPACE.x_min, WORKSPACE.y_min, WORKSPACE.table_z)
    assert corner == pytest.approx((0.276, -0.224, -0.15))


# --- closed forms -----------------------------------------------------------------------------


@pytest.mark.parametrize("camera", [HD, VGA])
@given(pose=camera_poses, tilt_x=st.floats(-0.15, 0.15), tilt_y=st.floats(-0.15, 0.15))
@settings(max_examples=5, deadline=None)
def test_a_tilted_plane_has_its_height_everywhere_it_is_seen(
    camera: Intrinsics, pose: Transform, tilt_x: float, tilt_y: float
) -> None:
    normal = np.array([-tilt_x, -tilt_y, 1.0])
    offset = float(normal @ (0.5, 0.0, WORKSPACE.table_z))
    plane = Plane(normal=(-tilt_x, -tilt_y, 1.0), offset=offset)
    heightmap = build_heightmap(look(plane, None, camera, pose), pose, WORKSPACE)
    x, y = centers()
    true = tilt_x * (x - 0.5) + tilt_y * y
    # A sample lies up to half a pixel beside the centre, and the highest one in it wins.
    error = (heightmap.height - true)[heightmap.valid]
    assert np.abs(error).max() <= (abs(tilt_x) + abs(tilt_y)) * PIXEL / 2 + 1e-4
    assert heightmap.valid[60:164, 60:164].all()


@pytest.mark.parametrize("camera", [HD, VGA])
@given(
    pose=camera_poses,
    x=st.floats(0.42, 0.58),
    y=st.floats(-0.08, 0.08),
    yaw=st.floats(-np.pi, np.pi),
    size=st.tuples(st.floats(0.03, 0.1), st.floats(0.03, 0.1), st.floats(0.02, 0.08)),
)
@settings(max_examples=5, deadline=None)
def test_a_box_lies_where_it_lies(
    camera: Intrinsics,
    pose: Transform,
    x: float,
    y: float,
    yaw: float,
    size: tuple[float, float, float],
) -> None:
    heightmap = build_heightmap(look(TABLE, box_at(x, y, yaw, size), camera, pose), pose, WORKSPACE)
    dx, dy = centers()[0] - x, centers()[1] - y
    along, across = np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx
    outside = np.maximum(np.abs(along) - size[0] / 2, np.abs(across) - size[1] / 2)

    on_top = (outside < -PIXEL) & heightmap.valid
    assert on_top.sum() > 0.95 * (outside < -PIXEL).sum()
    assert np.abs(heightmap.height[on_top] - size[2]).max() <= 2e-4
    assert (heightmap.color[on_top] == BOX_RGB).all()
    beside = (outside > PIXEL) & heightmap.valid
    error = np.abs(heightmap.height[beside])
    assert error.max() <= 2e-3  # filled between the table and the foot of the box's side
    assert (error <= 2e-4).mean() > 0.995
    assert (heightmap.color[beside] != BOX_RGB).any(axis=-1).mean() > 0.995


def test_nothing_is_mirrored_or_shifted() -> None:
    """A box away from the robot (+x) and to its left (+y) is up and left in the map."""
    box = box_at(0.6, 0.1, 0.0, (0.06, 0.04, 0.05))
    heightmap = build_heightmap(look(TABLE, box, HD, X_BASE_CAMERA), X_BASE_CAMERA, WORKSPACE)
    rows, cols = np.nonzero(heightmap.height > 0.045)
    x, y = heightmap.workspace.to_base(rows.mean(), cols.mean())
    assert float(x) == pytest.approx(0.6, abs=PIXEL / 2)
    assert float(y) == pytest.approx(0.1, abs=PIXEL / 2)
    assert len(rows) == pytest.approx(30 * 20, rel=0.1)


def test_a_box_across_the_border_stands_in_the_map_and_in_its_rim() -> None:
    box = box_at(0.5, WORKSPACE.y_max, 0.0, (0.06, 0.10, 0.05))  # one half inside, one outside
    heightmap = build_heightmap(look(TABLE, box, HD, X_BASE_CAMERA), X_BASE_CAMERA, WORKSPACE)
    assert heightmap.rim is not None
    assert np.isnan(heightmap.rim[INSIDE, INSIDE]).all()
    rows, cols = np.nonzero(heightmap.rim > 0.045)
    assert heightmap.rim[rows, cols] == pytest.approx(0.05, abs=2e-4)
    x, y = WORKSPACE.to_base(rows - RIM, cols - RIM)
    assert (x.min(), x.max()) == pytest.approx((0.47, 0.53), abs=PIXEL)
    assert (y.min(), y.max()) == pytest.approx((0.224, 0.274), abs=PIXEL)
    assert len(rows) == pytest.approx(30 * 25, rel=0.1)


def test_lens_distortion_is_undone() -> None:
    """Rays that an iteration of our own undistorts, proven by cv2.projectPoints."""
    camera = replace(VGA, distortion=DISTORTION)
    row, col = np.mgrid[: camera.height, : camera.width]
    pixels = np.stack([col, row], axis=-1).astype(np.float64)
    target = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    rays = target.copy()
    for _ in range(25):
        rays += target - distorted(rays)
    again, _ = cv2.projectPoints(
        np.dstack([rays, np.ones(row.shape)]).reshape(-1, 1, 3),
        np.zeros(3),
        np.zeros(3),
        camera.as_matrix(),
        np.array(DISTORTION),
    )
    assert np.abs(again.reshape(pixels.shape) - pixels).max() < 1e-6

    box = box_at(0.42, 0.12, 0.4, (0.08, 0.05, 0.05))
    frame = look_along(np.dstack([rays, np.ones(row.shape)]), TABLE, box, camera, X_BASE_CAMERA)
    heightmap = build_heightmap(frame, X_BASE_CAMERA, WORKSPACE)
    true = build_heightmap(look(TABLE, box, VGA, X_BASE_CAMERA), X_BASE_CAMERA, WORKSPACE)
    inside = ndimage.binary_erosion(true.height > 0.045)
    assert np.abs(heightmap.height[inside] - 0.05).max() <= 2e-4
    beside = ndimage.binary_erosion(true.height < 0.005) & heightmap.valid
    assert np.abs(heightmap.height[beside]).max() <= 2e-4
    straight = build_heightmap(replace(frame, intrinsics=VGA), X_BASE_CAMERA, WORKSPACE)
    assert np.abs(straight.height - heightmap.height)[beside & straight.valid].max() > 5e-4


def distorted(rays: Array) -> Array:
    """Brown (1966), written out: radial, then tangential."""
    k1, k2, p1, p2, k3 = DISTORTION
    x, y = rays[..., 0], rays[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


@given(seed=st.integers(0, 10**6))
@settings(max_examples=5, deadline=None)
def test_the_highest_point_wins_as_in_double_precision(seed: int) -> None:
    """Against a plain NumPy scatter in float64, wherever that is not filled and not on a rim."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 0.9, (VGA.height, VGA.width))
    depth[rng.random(depth.shape) < 0.2] = np.nan
    frame = frame_of(depth, VGA, rng.integers(0, 256, (*depth.shape, 3), dtype=np.uint8))
    heightmap = build_heightmap(frame, X_BASE_CAMERA, WORKSPACE)
    row, col = np.mgrid[: VGA.height, : VGA.width]
    z = frame.depth.astype(np.float64)
    p_camera = np.stack([(col - VGA.cx) / VGA.fx * z, (row - VGA.cy) / VGA.fy * z, z], axis=-1)
    x, y, up = (X_BASE_CAMERA @ p_camera[np.isfinite(z)]).T
    i, j = (WORKSPACE.x_max - x) / PIXEL, (WORKSPACE.y_max - y) / PIXEL
    inside = (i >= 0) & (i < SIZE) & (j >= 0) & (j < SIZE)
    i, j, up = i[inside].astype(int), j[inside].astype(int), up[inside]
    reference = np.full((SIZE, SIZE), -np.inf)
    np.maximum.at(reference, (i, j), up - WORKSPACE.table_z)
    agree = np.abs(heightmap.height - reference) < 1e-4
    assert agree[np.isfinite(reference)].mean() > 0.999  # the rest: points on a pixel's border


# --- what is not known ------------------------------------------------------------------------


def test_a_hole_is_never_table() -> None:
    frame = look(TABLE, None, HD, X_BASE_CAMERA)
    frame.depth[300:420, 500:700] = np.nan
    heightmap = build_heightmap(frame, X_BASE_CAMERA, WORKSPACE)
    label, count = ndimage.label(~heightmap.valid)
    assert count == 1
    assert (label > 0).sum() > 1000
    assert (heightmap.color[~heightmap.valid] == 0).all()


def test_what_an_edge_hides_stays_unknown() -> None:
    """The camera stands beyond the box, so the strip on the robot's side of it is hidden."""
    box = box_at(0.45, 0.0, 0.0, (0.05, 0.08, 0.08))
    heightmap = build_heightmap(look(TABLE, box, HD, X_BASE_CAMERA), X_BASE_CAMERA, WORKSPACE)
    eye = X_BASE_CAMERA.translation
    top = WORKSPACE.table_z + 0.08
    back = 0.425
    shadow_end = back - (eye[0] - back) * 0.08 / (eye[2] - top)
    rows, _ = WORKSPACE.to_pixel([back - PIXEL, shadow_end + PIXEL], [0.0, 0.0])
    strip = heightmap.height[rows[0] : rows[1] + 1, 100:124]
    assert len(strip) > 10
    assert np.isnan(strip).all()


@pytest.mark.parametrize("camera", [HD, VGA])
def test_sampling_gaps_of_one_surface_are_filled(camera: Intrinsics) -> None:
    """From 1.1 m the 640-pixel camera leaves out pixels of the table, and none afterwards."""
    pose = looking_at((1.1, 0.1, 0.75), (0.5, 0.0, WORKSPACE.table_z))
    heightmap = build_heightmap(look(TABLE, None, camera, pose), pose, WORKSPACE)
    assert heightmap.valid[1:-1, 1:-1].all()
    assert np.abs(heightmap.height[heightmap.valid]).max() < 1e-4


def test_gaps_between_two_surfaces_are_not_filled() -> None:
    """Straight from above, two steps with one unseen pixel in between."""
    assert np.isnan(step_of(0.005).height[:, 112]).all()
    np.testing.assert_allclose(step_of(0.003).height[1:-1, 112], 0.0015, atol=1e-4)


def step_of(rise: float) -> Heightmap:
    """Table at the left, a surface higher by `rise` at the right, column 112 unseen."""
    pose = Transform(
        Rotation.from_matrix(np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])),
        np.array([0.5, 0.0, 0.65]),
    )
    camera = Intrinsics(width=400, height=400, fx=500.0, fy=500.0, cx=199.5, cy=199.5)
    low = look(TABLE, None, camera, pose).depth
    high = look(replace(TABLE, offset=TABLE.offset + rise), None, camera, pose).depth
    y_low, y_high = (-(np.arange(400) - camera.cx) / camera.fx * d[0] for d in (low, high))
    edge = WORKSPACE.y_max - 112 * PIXEL
    depth = np.full(low.shape, np.nan)
    depth[:, y_low > edge] = low[:, y_low > edge]
    beyond = y_high < edge - PIXEL
    depth[:, beyond] = high[:, beyond]
    return build_heightmap(frame_of(depth, camera), pose, WORKSPACE)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -0.5])
def test_depth_that_is_no_distance_is_unknown(value: float) -> None:
    heightmap = build_heightmap(frame_of(np.full((480, 640), value), VGA), X_BASE_CAMERA, WORKSPACE)
    assert not heightmap.valid.any()
    assert not heightmap.color.any()


# --- goal and bad frames ----------------------------------------------------------------------


def test_goal_pixels_follow_the_points_that_win() -> None:
    box = box_at(0.5, 0.05, 0.3, (0.06, 0.04, 0.05))
    frame = look(TABLE, box, HD, X_BASE_CAMERA)
    goal_pixels = (frame.color == BOX_RGB).all(axis=-1)
    heightmap = build_heightmap(frame, X_BASE_CAMERA, WORKSPACE, goal_pixels=goal_pixels)
    assert heightmap.goal is not None
    assert (heightmap.goal == (heightmap.color == BOX_RGB).all(axis=-1)).all()
    assert heightmap.goal.sum() > 500
    assert build_heightmap(frame, X_BASE_CAMERA, WORKSPACE).goal is None


def frame_with(**changes: object) -> RgbdFrame:
    return replace(frame_of(np.ones((480, 640)), VGA), **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (frame_with(depth=np.ones((480, 641), np.float32)), r"depth is \(480, 641\) float32"),
        (frame_with(depth=np.ones((480, 640))), r"depth is .* float64, .* float32"),
        (frame_with(color=np.ones((480, 640), np.uint8)), r"color is \(480, 640\) uint8"),
        (frame_with(intrinsics=HD), r"frame 7 of camera closed form: depth .* \(720, 1280\)"),
    ],
)
def test_a_frame_that_contradicts_itself_is_refused(frame: RgbdFrame, message: str) -> None:
    with pytest.raises(FrameError, match=message):
        build_heightmap(frame, X_BASE_CAMERA, WORKSPACE)


def test_goal_pixels_must_fit_the_frame() -> None:
    with pytest.raises(FrameError, match=r"goal_pixels is \(2, 2\) bool"):
        build_heightmap(
            frame_with(), X_BASE_CAMERA, WORKSPACE, goal_pixels=np.zeros((2, 2), np.bool_)
        )
