from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pybullet
import pytest
from closed_form import HD, VGA, Box, Plane, look, looking_at
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics
from tdpg_deploy.sim.pieces import TABLE, ConvexPiece, VisiblePiece
from tdpg_deploy.sim.render import NOTHING, Lighting, Rendering, render

EYE = looking_at((0.8, 0.1, 0.55), (0.5, 0.0, -0.15))
SMALL = Intrinsics(width=96, height=72, fx=90.0, fy=91.0, cx=48.3, cy=34.9)
CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
NOON = Lighting(direction=(0, 0, 1), ambient=0.4)

floats = st.floats(-1, 1, allow_subnormal=False)
rotations = st.builds(
    lambda axis, angle: Rotation.from_rotvec(np.array(axis) * angle),
    st.tuples(floats, floats, floats),
    st.floats(0, 3),
)


def box(
    size: tuple[float, float, float],
    at: tuple[float, float, float],
    rotation: Rotation | None = None,
    *,
    rgb: tuple[int, int, int] = (200, 100, 50),
    owner: int = 0,
) -> VisiblePiece:
    piece = ConvexPiece.from_vertices(CUBE * size)
    pose = Transform(rotation or Rotation.identity(), np.array(at))
    return VisiblePiece(piece, pose, rgb, owner)


def table(side: float = 4.0) -> VisiblePiece:
    """So large that it passes below and behind the camera."""
    return box((side, side, 0.1), (0.5, 0.0, -0.2), rgb=(180, 180, 180), owner=TABLE)


def assert_same_depth(seen: npt.ArrayLike, true: npt.ArrayLike, *, within: float = 1e-5) -> None:
    """But for pixels whose centre lies on an outline, to rounding."""
    seen, true = np.asarray(seen, np.float64), np.asarray(true, np.float64)
    outline = np.isnan(seen) != np.isnan(true)
    assert outline.mean() < 1e-4
    difference = np.abs(seen - true)[~outline]
    assert np.nanmax(difference, initial=0.0) <= within


# --- depth against closed forms ---------------------------------------------------------------


@given(
    eye=st.tuples(st.floats(0.6, 1.1), st.floats(-0.4, 0.4), st.floats(0.2, 0.8)),
    rotation=rotations,
    size=st.tuples(st.floats(0.02, 0.3), st.floats(0.02, 0.3), st.floats(0.02, 0.3)),
)
@settings(max_examples=6, deadline=None)
def test_depth_of_a_box_on_a_plane(
    eye: tuple[float, float, float],
    rotation: Rotation,
    size: tuple[float, float, float],
) -> None:
    pose = looking_at(eye, (0.5, 0.0, -0.15))
    at = (0.45, 0.03, -0.1)
    seen = render([table(), box(size, at, rotation)], VGA, pose)
    true = look(
        Plane(normal=(0, 0, 1), offset=-0.15),
        Box(size=size, X_base_box=Transform(rotation, np.array(at))),
        VGA,
        pose,
    )
    assert_same_depth(seen.depth, np.where(true.depth < 2.0, true.depth, seen.depth))


@given(
    points=st.lists(st.tuples(floats, floats, floats), min_size=4, max_size=12, unique=True),
    center=st.tuples(floats, floats, st.floats(-1.5, 4)),
    rotation=rotations,
)
@settings(max_examples=60, deadline=None)
def test_depth_of_any_convex_piece_anywhere(
    points: list[tuple[float, float, float]],
    center: tuple[float, float, float],
    rotation: Rotation,
) -> None:
    """Before, beside, behind or around the camera; against all half-spaces on all rays."""
    spread = np.array(points) + np.random.default_rng(0).normal(0, 0.05, (len(points), 3))
    piece = ConvexPiece.from_vertices(spread)
    pose = Transform(rotation, np.array(center))
    seen = render([VisiblePiece(piece, pose, (9, 9, 9), 3)], SMALL, Transform.identity())
    true = clipped_rays(piece, pose, SMALL)
    assert_same_depth(1 / seen.depth, 1 / true, within=1e-4)
    assert ((seen.owner == 3) == np.isfinite(seen.depth)).all()


def clipped_rays(piece: ConvexPiece, X_camera_piece: Transform, camera: Intrinsics) -> Array:
    """(H, W) depth where each ray enters all half-spaces before it leaves any, else nan."""
    row, col = np.mgrid[: camera.height, : camera.width]
    rays = np.stack(
        [(col - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, np.ones(row.shape)], axis=-1
    )
    X_piece_camera = X_camera_piece.inverse()
    start = X_piece_camera.translation
    along = rays @ X_piece_camera.rotation.as_matrix().T
    rate = along @ piece.planes[:, :3].T
    inside = piece.planes[:, :3] @ start + piece.planes[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -inside / rate
    entry = np.where(rate < 0, crossing, -np.inf).max(axis=-1)
    leave = np.where(rate > 0, crossing, np.inf).min(axis=-1)
    return np.where((entry > 0) & (entry < leave), entry, np.nan)


def pile() -> list[VisiblePiece]:
    """Twenty-five boxes through each other."""
    rng = np.random.default_rng(5)
    return [
        box(tuple(size), tuple(place), turn, owner=owner)
        for owner, (size, place, turn) in enumerate(
            zip(
                rng.uniform(0.02, 0.1, (25, 3)),
                rng.uniform((0.35, -0.15, -0.13), (0.65, 0.15, -0.02), (25, 3)),
                Rotation.random(25, rng),
                strict=True,
            )
        )
    ]


def test_depth_and_owners_of_a_pile() -> None:
    pieces = [table(), *pile()]
    seen = render(pieces, SMALL, EYE)
    X_camera_base = EYE.inverse()
    each = np.stack(
        [clipped_rays(item.piece, X_camera_base @ item.X_base_piece, SMALL) for item in pieces]
    )
    each[np.isnan(each)] = np.inf
    np.testing.assert_allclose(seen.depth, each.min(axis=0), atol=1e-5)
    owners = np.array([item.owner for item in pieces])
    assert (seen.owner == owners[each.argmin(axis=0)]).all()


@pytest.mark.slow
def test_a_pile_is_what_pybullets_rays_meet() -> None:
    pieces = [table(), *pile()]
    seen = render(pieces, VGA, EYE)
    client = pybullet.connect(pybullet.DIRECT)
    try:
        for item in pieces:
            half = np.ptp(item.piece.vertices, axis=0) / 2
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_BOX, halfExtents=half.tolist(), physicsClientId=client
            )
            pybullet.createMultiBody(
                0,
                shape,
                basePosition=item.X_base_piece.translation.tolist(),
                baseOrientation=item.X_base_piece.rotation.as_quat().tolist(),
                physicsClientId=client,
            )
        row, col = (a.ravel() for a in np.mgrid[0:480:4, 0:640:4])
        reach = 2.0
        ends = EYE @ (
            reach
            * np.stack(
                [(col - VGA.cx) / VGA.fx, (row - VGA.cy) / VGA.fy, np.ones(row.shape)], axis=1
            )
        )
        hits = []
        for some in np.array_split(ends, 4):  # pybullet takes 16384 rays at most
            starts = np.tile(EYE.translation, (len(some), 1))
            hits += pybullet.rayTestBatch(starts.tolist(), some.tolist(), physicsClientId=client)
    finally:
        pybullet.disconnect(client)
    depth = np.array([reach * hit[2] for hit in hits])
    difference = np.abs(seen.depth[row, col] - depth)
    # Bullet's ray cast iterates: on steep faces and edges it stops within a millimetre or so.
    assert np.median(difference) < 1e-6
    assert (difference < 1e-4).mean() > 0.95
    assert (difference < 2e-3).mean() > 0.985
    body = np.array([hit[0] for hit in hits])
    owners = np.array([item.owner for item in pieces])
    assert (owners[body] == seen.owner[row, col]).mean() > 0.99


# --- what is seen -----------------------------------------------------------------------------


def test_the_nearest_owner_is_seen() -> None:
    low = box((0.1, 0.1, 0.05), (0.5, 0.0, -0.125), owner=4)
    high = box((0.05, 0.05, 0.05), (0.5, 0.0, -0.075), owner=9)
    for order in ([low, high, table()], [table(), high, low]):
        seen = render(order, VGA, EYE)
        assert set(np.unique(seen.owner)) == {TABLE, 4, 9}
        assert owner_at(seen, (0.5, 0.0, -0.05)) == 9
        assert owner_at(seen, (0.54, 0.0, -0.1)) == 4
        assert owner_at(seen, (0.58, 0.0, -0.15)) == TABLE


def owner_at(seen: Rendering, p_base: tuple[float, float, float]) -> int:
    x, y, z = EYE.inverse() @ np.array(p_base)
    return int(seen.owner[round(VGA.fy * y / z + VGA.cy), round(VGA.fx * x / z + VGA.cx)])


def test_an_empty_world_is_background() -> None:
    seen = render([], SMALL, EYE, Lighting(background=(1, 2, 3)))
    assert np.isnan(seen.depth).all()
    assert (seen.owner == NOTHING).all()
    assert (seen.color == (1, 2, 3)).all()
    for array, dtype in ((seen.depth, "float32"), (seen.owner, "int16"), (seen.color, "uint8")):
        assert array.dtype == dtype


def test_a_piece_around_the_camera_hides_nothing() -> None:
    around = box((0.5, 0.5, 0.5), tuple(EYE.translation), owner=5)
    seen = render([table(), around], SMALL, EYE)
    assert (seen.depth[np.isfinite(seen.depth)] > 0.3).all()
    assert 5 not in seen.owner


def test_lens_distortion_is_not_rendered_silently() -> None:
    with pytest.raises(ValueError, match="undistorted pinhole"):
        render([table()], replace(SMALL, distortion=(0.1, 0, 0, 0, 0)), EYE)


# --- light ------------------------------------------------------------------------------------


def test_faces_are_lit_by_lamberts_law() -> None:
    above = looking_at((0.5, 0.001, 0.5), (0.5, 0.0, -0.15))
    for tilt in (0.0, 0.3, 1.0):
        lamp = (np.sin(tilt), 0.0, np.cos(tilt))
        seen = render([table()], SMALL, above, Lighting(direction=lamp, ambient=0.4))
        assert abs(int(seen.color[36, 48, 0]) - 180 * (0.4 + 0.6 * np.cos(tilt))) <= 1


def test_a_face_that_turns_from_the_lamp_has_the_skys_light_only() -> None:
    side = looking_at((1.5, 0.0, -0.1), (0.5, 0.0, -0.12))
    cube = box((0.1, 0.1, 0.1), (0.5, 0.0, -0.1), rgb=(200, 100, 50))
    seen = render([cube], VGA, side, NOON)
    wall = seen.color[seen.owner == 0]
    np.testing.assert_allclose(wall.max(axis=0), np.array((200, 100, 50)) * 0.4 * 0.8, atol=1)


def test_a_shadow_falls_away_from_the_lamp() -> None:
    """With the lamp at 45 degrees above +x, a cube's shadow reaches its height towards -x."""
    lamp = Lighting(direction=(1, 0, 1), ambient=0.4, shadow_side=0.6)
    scene = [table(), box((0.06, 0.06, 0.06), (0.5, 0.0, -0.12))]
    above = looking_at((0.5, 0.001, 0.6), (0.5, 0.0, -0.15))
    with_shadow = render(scene, HD, above, lamp)
    without = render(scene, HD, above, replace(lamp, shadow_side=0.0))
    assert np.array_equal(with_shadow.depth, without.depth, equal_nan=True)
    darker = (with_shadow.color != without.color).any(axis=-1)
    row, col = np.nonzero(darker)
    z = with_shadow.depth[row, col]
    p_camera = np.stack([(col - HD.cx) / HD.fx * z, (row - HD.cy) / HD.fy * z, z], axis=1)
    x, y, height = (above @ p_camera.astype(np.float64)).T
    assert (with_shadow.owner[row, col] == TABLE).all()
    np.testing.assert_allclose(height, -0.15, atol=1e-5)
    np.testing.assert_allclose((x.min(), x.max()), (0.41, 0.47), atol=0.004)
    np.testing.assert_allclose((y.min(), y.max()), (-0.03, 0.03), atol=0.004)


@pytest.mark.parametrize(
    ("ambient", "direction"), [(-0.1, (0, 0, 1)), (1.1, (0, 0, 1)), (0.5, (0, 0, 0))]
)
def test_light_that_cannot_be_is_refused(
    ambient: float, direction: tuple[float, float, float]
) -> None:
    with pytest.raises(ValueError, match=r"ambient|direction"):
        Lighting(ambient=ambient, direction=direction)
