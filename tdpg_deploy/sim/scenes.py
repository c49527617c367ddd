"""What lies on the table: objects with shape, pose, colour and goal flag, and random heaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from policies.heightmap import Workspace
from tdpg_deploy.errors import SceneError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.sim.bodies import SHAPES, Shape

MAX_OBJECTS = 30  # the paper's densest scenes
SPAWN_CLEARANCE = 0.01  # m between objects before they fall
SPAWN_MARGIN = 0.03  # m between the outermost objects and the border, before they fall
MAX_PACKED = 9
PACK_WIDTH = 0.20  # m of a row, at most
PACK_GAP = 0.002  # m between neighbours at most; a finger is 18 mm thick
PACK_SHIFT = 0.02  # m of a row against the one before
MAX_HEIGHT = 2.0  # m above the table

# Tableau's ten colours, as in VPG: blue, orange, green, red, purple, brown, pink, grey, gold, teal.
PALETTE = (
    (78, 121, 167),
    (242, 142, 43),
    (89, 161, 79),
    (225, 87, 89),
    (176, 122, 161),
    (156, 117, 95),
    (255, 157, 167),
    (186, 176, 172),
    (237, 201, 72),
    (118, 183, 178),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneObject:
    """goal: whether this is the object to fetch. rgb: 0..255, sRGB."""

    shape: Shape
    X_base_object: Transform
    rgb: tuple[int, int, int]
    goal: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    objects: tuple[SceneObject, ...]

    def check(self, workspace: Workspace) -> None:
        """Raises SceneError that names the first object outside of the workspace."""
        for index, item in enumerate(self.objects):
            x, y, z = item.X_base_object.translation
            if not workspace.contains(x, y):
                raise SceneError(
                    f"object[{index}].position = ({x:.3f}, {y:.3f}, {z:.3f}) m lies outside of the "
                    f"workspace x [{workspace.x_min:.3f}, {workspace.x_max:.3f}], "
                    f"y [{workspace.y_min:.3f}, {workspace.y_max:.3f}]: move it inside"
                )
            if not 0 <= z - workspace.table_z <= MAX_HEIGHT:
                raise SceneError(
                    f"object[{index}].position: z = {z:.3f} m is not 0 to {MAX_HEIGHT:g} m above "
                    f"the table at {workspace.table_z:.3f} m: move it there"
                )

    def with_goal(self, index: int) -> Scene:
        """With this object, and no other, as the one to fetch."""
        return Scene(
            objects=tuple(replace(item, goal=i == index) for i, item in enumerate(self.objects))
        )


def random_scene(
    n: int,
    workspace: Workspace,
    rng: np.random.Generator,
    shapes: Mapping[str, Shape] = SHAPES,
) -> Scene:
    """n objects of random shape, pose and colour above the workspace, clear of each other, ready
    to fall. Raises SceneError for n outside of 1..30."""
    if not 1 <= n <= MAX_OBJECTS:
        raise SceneError(f"{n} objects asked for: ask for 1 to {MAX_OBJECTS}")
    names = sorted(shapes)
    spawner = Spawner(workspace, rng)
    first = int(rng.integers(len(PALETTE)))
    objects = []
    for index in range(n):
        shape = shapes[names[rng.integers(len(names))]]
        objects.append(
            SceneObject(
                shape=shape,
                X_base_object=spawner.pose(shape),
                rgb=PALETTE[(first + index) % len(PALETTE)],
            )
        )
    return Scene(objects=tuple(objects))


def packed_scene(
    n: int,
    workspace: Workspace,
    rng: np.random.Generator,
    shapes: Mapping[str, Shape] = SHAPES,
) -> Scene:
    """n objects of up to three kinds that stand upright in rows, neighbours so close that no finger
    fits between them, the whole of it somewhere and turned somehow. Raises SceneError for n outside
    of 1..9."""
    if not 1 <= n <= MAX_PACKED:
        raise SceneError(f"{n} objects asked for in a pack: ask for 1 to {MAX_PACKED}")
    names = sorted(shapes)
    room = -1.0
    while room < 0:  # a pack of long ones may be larger than the workspace
        kinds = [
            (shapes[name], Rotation.from_euler("z", np.pi / 2 * rng.integers(2)))
            for name in rng.choice(names, rng.integers(1, 4))
        ]
        chosen, turns = zip(*(kinds[rng.integers(len(kinds))] for _ in range(n)), strict=True)
        boxes = [
            np.ptp(turn.apply(shape.vertices), axis=0)
            for shape, turn in zip(chosen, turns, strict=True)
        ]
        corners = _in_rows(boxes, rng)
        across = np.max(
            [corner + box[:2] for corner, box in zip(corners, boxes, strict=True)], axis=0
        )
        room = workspace.side / 2 - SPAWN_MARGIN - np.hypot(*across) / 2

    whole = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
    middle = workspace.middle + rng.uniform(-room, room, 2)
    objects = []
    for index, (shape, turn, corner) in enumerate(zip(chosen, turns, corners, strict=True)):
        low = turn.apply(shape.vertices).min(axis=0)
        place = whole.apply([*(corner - across / 2 - low[:2]), 0.0])
        position = np.array([*(middle + place[:2]), workspace.table_z - low[2]])
        objects.append(
            SceneObject(
                shape=shape,
                X_base_object=Transform(whole * turn, position),
                rgb=PALETTE[index % len(PALETTE)],
            )
        )
    return Scene(objects=tuple(objects))


def _in_rows(boxes: Sequence[Array], rng: np.random.Generator) -> list[Array]:
    """Lower corners (x, y) of boxes, side by side in rows of PACK_WIDTH."""
    corners = []
    x = y = deepest = 0.0
    for box in boxes:
        if x and x + box[0] > PACK_WIDTH:
            x, y, deepest = rng.uniform(0, PACK_SHIFT), y + deepest, 0.0
        corners.append(np.array([x, y]))
        gap = rng.uniform(0.0003, PACK_GAP)
        x, deepest = x + box[0] + gap, max(deepest, box[1] + gap)
    return corners


class Spawner:
    """Random poses above the workspace, each clear of what is there and of those before."""

    def __init__(
        self, workspace: Workspace, rng: np.random.Generator, *, above: float | None = None
    ) -> None:
        """above: height in base (m) below which all is taken; the table's when not given."""
        self._workspace = workspace
        self._rng = rng
        self._floor = workspace.table_z if above is None else above
        self._taken: list[tuple[Array, Array]] = []  # lowest and highest corners of boxes

    def pose(self, shape: Shape) -> Transform:
        """As low as it fits at a random place and turn."""
        rotation = Rotation.random(random_state=self._rng)
        corners = shape.vertices @ rotation.as_matrix().T
        low, high = corners.min(axis=0), corners.max(axis=0)
        square = self._workspace
        x = self._rng.uniform(
            square.x_min + SPAWN_MARGIN - low[0], square.x_max - SPAWN_MARGIN - high[0]
        )
        y = self._rng.uniform(
            square.y_min + SPAWN_MARGIN - low[1], square.y_max - SPAWN_MARGIN - high[1]
        )
        gap = SPAWN_CLEARANCE
        below = [
            top[2]
            for bottom, top in self._taken
            if bottom[0] - gap < x + high[0]
            and x + low[0] < top[0] + gap
            and bottom[1] - gap < y + high[1]
            and y + low[1] < top[1] + gap
        ]
        z = max([self._floor, *below]) + gap - low[2]
        place = np.array([x, y, z])
        self._taken.append((place + low, place + high))
        return Transform(rotation, place)
