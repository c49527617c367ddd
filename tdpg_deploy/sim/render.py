"""The one renderer: convex pieces seen through a pinhole, exact at pixel centres.

Along the ray z * (u, v, 1) of a pixel, the plane n.p + d = 0 is met at the nearness
w = 1 / z = -(n.(u, v, 1)) / d, which is affine in the pixel. A convex piece is entered at the
smallest w of the planes that face the eye (d > 0), and is hit there unless a plane that faces
away (d < 0) was left before. Along parallel rays the same holds for the distance towards the
lamp, so the kernel that draws the picture also finds the cast shadows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tdpg_deploy.compiled import compiled
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics
from tdpg_deploy.sim.pieces import VisiblePiece

NOTHING = -32768  # owner of a pixel that sees no piece

_NEAR = 1e-3  # m; a vertex nearer than this to the camera's plane has no sound projection
_TINY = 1e-12  # keeps planes that contain the ray's origin off a division by zero
_SHADOW_SIZE = 640  # pixels a side of the lamp's view

Floats = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Lighting:
    """A distant lamp, and light from the sky.

    direction: towards the lamp, base frame, any length. ambient: the sky's share, 0..1.
    shadow_side: shadows are cast within a square of this side (m) around the scene's objects;
    0 casts none and is faster. background: RGB where nothing is.
    """

    direction: tuple[float, float, float] = (0.4, 0.5, 1.0)
    ambient: float = 0.5
    shadow_side: float = 0.0
    background: tuple[int, int, int] = (205, 211, 218)

    def __post_init__(self) -> None:
        if not 0 <= self.ambient <= 1:
            raise ValueError(f"ambient is a share of the light, 0 to 1, got {self.ambient}")
        if not np.linalg.norm(self.direction) > 0:
            raise ValueError("direction must point somewhere, got a vector of length zero")

    @property
    def towards_lamp(self) -> Array:
        """(3,) unit vector."""
        direction = np.array(self.direction, np.float64)
        return direction / np.linalg.norm(direction)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rendering:
    """depth: (H, W) float32, metres along the optical axis, nan where nothing is.
    owner: (H, W) int16, of the piece seen, or NOTHING. color: (H, W, 3) uint8 RGB."""

    depth: Floats
    owner: npt.NDArray[np.int16]
    color: Bytes


def render(
    pieces: Sequence[VisiblePiece],
    intrinsics: Intrinsics,
    X_base_camera: Transform,
    lighting: Lighting | None = None,
) -> Rendering:
    """See the pieces. A piece that contains the camera is not seen; nor is lens distortion.

    Raises ValueError if the intrinsics distort.
    """
    if any(intrinsics.distortion):
        raise ValueError(f"only an undistorted pinhole is rendered, got {intrinsics.distortion}")
    lighting = lighting or Lighting()
    scene = _Scene.of(pieces)
    affine, faces_eye = _seen_through_pinhole(scene, intrinsics, X_base_camera)
    nearness, face = _draw(
        affine,
        faces_eye,
        scene.first_plane,
        _projected_boxes(scene, intrinsics, X_base_camera),
        (intrinsics.height, intrinsics.width),
        floor=0.0,
    )
    lit, shaded = _palette(scene, lighting)
    if lighting.shadow_side > 0 and len(pieces):
        shade = _shade(scene, intrinsics, X_base_camera, lighting, nearness, face)
    else:
        shade = np.zeros((1, 1), np.float32)
    depth, owner, color = _develop(nearness, face, scene.owners, lit, shaded, shade)
    return Rendering(depth=depth, owner=owner, color=color)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Scene:
    """All pieces in base, one after the other: piece i owns first_plane[i] : first_plane[i+1].

    normals (M, 3), offsets (M,), owners (M,) int16, colors (M, 3): per plane.
    vertices (V, 3), first_vertex (N + 1,).
    """

    normals: Array
    offsets: Array
    owners: npt.NDArray[np.int16]
    colors: Array
    first_plane: Ints
    vertices: Array
    first_vertex: Ints

    @classmethod
    def of(cls, pieces: Sequence[VisiblePiece]) -> _Scene:
        n_planes = np.array([len(p.piece.planes) for p in pieces], np.int64)
        n_vertices = np.array([len(p.piece.vertices) for p in pieces], np.int64)
        planes = np.concatenate([np.empty((0, 4)), *(p.piece.planes for p in pieces)])
        vertices = np.concatenate([np.empty((0, 3)), *(p.piece.vertices for p in pieces)])
        quaternions = [p.X_base_piece.rotation.as_quat() for p in pieces]
        rotations = (
            Rotation.from_quat(np.array(quaternions)).as_matrix() if pieces else np.empty((0, 3, 3))
        )
        origins = np.array([p.X_base_piece.translation for p in pieces]).reshape(-1, 3)
        of_plane = np.repeat(np.arange(len(pieces)), n_planes)
        of_vertex = np.repeat(np.arange(len(pieces)), n_vertices)
        normals = np.einsum("mij,mj->mi", rotations[of_plane], planes[:, :3])
        return cls(
            normals=normals,
            offsets=planes[:, 3] - np.einsum("mi,mi->m", normals, origins[of_plane]),
            owners=np.array([p.owner for p in pieces], np.int16)[of_plane],
            colors=np.array([p.rgb for p in pieces], np.float64).reshape(-1, 3)[of_plane],
            first_plane=np.concatenate([[0], np.cumsum(n_planes)]).astype(np.int64),
            vertices=np.einsum("mij,mj->mi", rotations[of_vertex], vertices) + origins[of_vertex],
            first_vertex=np.concatenate([[0], np.cumsum(n_vertices)]).astype(np.int64),
        )


def _seen_through_pinhole(
    scene: _Scene, intrinsics: Intrinsics, X_base_camera: Transform
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """(M, 3) a, b, c of each plane's nearness a * col + b * row + c, and whether it faces us."""
    normals = scene.normals @ X_base_camera.rotation.as_matrix()
    offsets = _away_from_zero(scene.offsets + scene.normals @ X_base_camera.translation)
    per_column = normals[:, 0] / intrinsics.fx
    per_row = normals[:, 1] / intrinsics.fy
    constant = normals[:, 2] - per_column * intrinsics.cx - per_row * intrinsics.cy
    affine = np.stack([per_column, per_row, constant], axis=1) / -offsets[:, None]
    return affine, offsets > 0


def _away_from_zero(values: Array) -> Array:
    return np.where(np.abs(values) < _TINY, _TINY, values)


def _projected_boxes(scene: _Scene, intrinsics: Intrinsics, X_base_camera: Transform) -> Ints:
    """(N, 4) rows and columns [first, end) that hold each piece; empty if it is out of sight.

    A piece that crosses the camera's plane may show anywhere.
    """
    x, y, z = (X_base_camera.inverse() @ scene.vertices).T
    depth = np.maximum(z, _NEAR)
    columns = intrinsics.cx + intrinsics.fx * x / depth
    rows = intrinsics.cy + intrinsics.fy * y / depth
    boxes = _boxes(rows, columns, scene.first_vertex, (intrinsics.height, intrinsics.width))
    if len(boxes):
        nearest = np.minimum.reduceat(z, scene.first_vertex[:-1])
        farthest = np.maximum.reduceat(z, scene.first_vertex[:-1])
        boxes[nearest < _NEAR] = (0, intrinsics.height, 0, intrinsics.width)
        boxes[farthest < _NEAR] = 0
    return boxes


def _boxes(rows: Array, columns: Array, first: Ints, shape: tuple[int, int]) -> Ints:
    """(N, 4) [first row, end row, first column, end column) around each piece's vertices."""
    if len(first) == 1:
        return np.empty((0, 4), np.int64)
    edges = []
    for values, size in ((rows, shape[0]), (columns, shape[1])):
        edges.append(np.clip(np.ceil(np.minimum.reduceat(values, first[:-1])), 0, size))
        edges.append(np.clip(np.floor(np.maximum.reduceat(values, first[:-1])) + 1, 0, size))
    return np.stack(edges, axis=1).astype(np.int64)


def _palette(scene: _Scene, lighting: Lighting) -> tuple[Floats, Floats]:
    """(M, 3) each: colour of each face in the lamp's light, and in the sky's alone."""
    lamp = np.maximum(scene.normals @ lighting.towards_lamp, 0)
    sky = lighting.ambient * (0.8 + 0.2 * scene.normals[:, 2])
    shaded = scene.colors * sky[:, None]
    lit = shaded + scene.colors * ((1 - lighting.ambient) * lamp)[:, None]
    background = np.array([lighting.background], np.float64)
    return (
        np.concatenate([lit, background]).astype(np.float32),
        np.concatenate([shaded, background]).astype(np.float32),
    )


def _shade(
    scene: _Scene,
    intrinsics: Intrinsics,
    X_base_camera: Transform,
    lighting: Lighting,
    nearness: Floats,
    face: npt.NDArray[np.int32],
) -> Floats:
    """(H, W) 0..1: how much of the lamp each seen point misses, 0 outside of the shadow square."""
    towards_lamp = lighting.towards_lamp
    R_lamp_base = _lamp_axes(towards_lamp)
    pixel = lighting.shadow_side / _SHADOW_SIZE
    objects = np.repeat(scene.owners[scene.first_plane[:-1]], np.diff(scene.first_vertex)) >= 0
    middle = scene.vertices[objects if objects.any() else slice(None)].mean(axis=0)
    # Lamp frame in pixels: row, column, and height towards the lamp in metres.
    A = R_lamp_base / np.array([[pixel], [pixel], [1.0]])
    offset = np.array([_SHADOW_SIZE / 2, _SHADOW_SIZE / 2, 0.0]) - A @ middle

    rows, columns, _ = (scene.vertices @ A.T + offset).T
    boxes = _boxes(rows, columns, scene.first_vertex, (_SHADOW_SIZE, _SHADOW_SIZE))
    normals = scene.normals @ np.linalg.inv(A)
    offsets = scene.offsets - normals @ offset
    slope = _away_from_zero(normals[:, 2])
    affine = np.stack([normals[:, 1], normals[:, 0], offsets], axis=1) / -slope[:, None]
    height, _ = _draw(
        affine,
        slope > 0,
        scene.first_plane,
        boxes,
        (_SHADOW_SIZE, _SHADOW_SIZE),
        floor=-np.inf,
    )
    # The steeper the light falls on a face, the more its height varies within a pixel.
    bias = np.clip(2 * np.hypot(affine[:, 0], affine[:, 1]), 5e-4, 0.02).astype(np.float32)
    eye = A @ X_base_camera.rotation.as_matrix()
    ray = eye @ np.linalg.inv(intrinsics.as_matrix())
    start = A @ X_base_camera.translation + offset
    return _compare_with_lamp(nearness, face, height, bias, ray, start)


def _lamp_axes(towards_lamp: Array) -> Array:
    """(3, 3) rotation from base to a frame whose z points towards the lamp."""
    helper = np.eye(3)[np.argmin(np.abs(towards_lamp))]
    x = np.cross(helper, towards_lamp)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(towards_lamp, x), towards_lamp])


@compiled
def _draw(
    affine: Array,
    faces_eye: npt.NDArray[np.bool_],
    first_plane: Ints,
    boxes: Ints,
    shape: tuple[int, int],
    floor: float,
) -> tuple[Floats, npt.NDArray[np.int32]]:
    """Nearness of the nearest hit (`floor` where none) and its plane (-1 where none)."""
    nearness = np.full(shape, floor, np.float32)
    face = np.full(shape, -1, np.int32)
    entered = np.empty(shape[1])
    left = np.empty(shape[1])
    through = np.empty(shape[1], np.int32)
    for piece in range(len(boxes)):
        top, bottom, start, end = boxes[piece]
        for row in range(top, bottom):
            entered[start:end] = np.inf
            left[start:end] = floor
            for plane in range(first_plane[piece], first_plane[piece + 1]):
                slope = affine[plane, 0]
                base = affine[plane, 1] * row + affine[plane, 2]
                if faces_eye[plane]:
                    for col in range(start, end):
                        value = slope * col + base
                        nearer = value < entered[col]
                        entered[col] = value if nearer else entered[col]
                        through[col] = plane if nearer else through[col]
                else:
                    for col in range(start, end):
                        left[col] = max(left[col], slope * col + base)
            for col in range(start, end):
                value = entered[col]
                if left[col] < value < np.inf and value > nearness[row, col]:
                    nearness[row, col] = value
                    face[row, col] = through[col]
    return nearness, face


@compiled
def _develop(
    nearness: Floats,
    face: npt.NDArray[np.int32],
    owners: npt.NDArray[np.int16],
    lit: Floats,
    shaded: Floats,
    shade: Floats,
) -> tuple[Floats, npt.NDArray[np.int16], Bytes]:
    """Turn nearness and faces into depth, owners and colours. shade: (H, W), or (1, 1) of 0."""
    rows, columns = nearness.shape
    depth = np.empty((rows, columns), np.float32)
    owner = np.empty((rows, columns), np.int16)
    color = np.empty((rows, columns, 3), np.uint8)
    has_shade = shade.shape[0] == rows
    for row in range(rows):
        for col in range(columns):
            plane = face[row, col]
            seen = plane >= 0
            depth[row, col] = np.float32(1) / nearness[row, col] if seen else np.float32(np.nan)
            owner[row, col] = owners[plane] if seen else NOTHING
            missing = shade[row, col] if has_shade else np.float32(0)
            for channel in range(3):
                full = lit[plane, channel]  # plane -1: the last row, the background
                value = full + missing * (shaded[plane, channel] - full)
                color[row, col, channel] = np.uint8(min(value + np.float32(0.5), np.float32(255)))
    return depth, owner, color


@compiled
def _compare_with_lamp(
    nearness: Floats,
    face: npt.NDArray[np.int32],
    height: Floats,
    bias: Floats,
    ray: Array,
    start: Array,
) -> Floats:
    """Share of the lamp's four nearest samples that see something above the point."""
    shade = np.zeros(nearness.shape, np.float32)
    last_row, last_column = height.shape[0] - 1, height.shape[1] - 1
    for row in range(nearness.shape[0]):
        for col in range(nearness.shape[1]):
            plane = face[row, col]
            if plane < 0:
                continue
            depth = 1.0 / nearness[row, col]
            y = start[0] + depth * (ray[0, 0] * col + ray[0, 1] * row + ray[0, 2])
            x = start[1] + depth * (ray[1, 0] * col + ray[1, 1] * row + ray[1, 2])
            if not (0 <= y < last_row and 0 <= x < last_column):
                continue
            z = start[2] + depth * (ray[2, 0] * col + ray[2, 1] * row + ray[2, 2]) + bias[plane]
            i, j = int(y), int(x)
            below, right = y - i, x - j
            shade[row, col] = (1 - below) * (
                (1 - right) * (height[i, j] > z) + right * (height[i, j + 1] > z)
            ) + below * ((1 - right) * (height[i + 1, j] > z) + right * (height[i + 1, j + 1] > z))
    return shade
