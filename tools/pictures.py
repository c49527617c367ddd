"""The pictures of the documentation, taken in the simulated cell: python -m tools.pictures

Each public function makes one file of docs/images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.geometry import Transform, top_down
from tdpg_deploy.hal import Intrinsics
from tdpg_deploy.sim.arm import SimArm
from tdpg_deploy.sim.bodies import box
from tdpg_deploy.sim.furniture import FLOOR_DEPTH
from tdpg_deploy.sim.gripper import SimGripper
from tdpg_deploy.sim.novel import NOVEL
from tdpg_deploy.sim.pieces import TABLE, ConvexPiece, VisiblePiece
from tdpg_deploy.sim.render import Lighting, render
from tdpg_deploy.sim.scene_file import parse_scene
from tdpg_deploy.sim.scenes import PALETTE, Scene, SceneObject, random_scene
from tdpg_deploy.sim.world import World
from tdpg_deploy.workspace import workspace_of
from tools.evaluate.tables import CASES_MIDDLE, challenge_cases

IMAGES = Path(__file__).parents[1] / "docs" / "images"
LENS = Intrinsics(width=1080, height=800, fx=1420.0, fy=1420.0, cx=507.5, cy=399.5)
LAMP = (0.8, -0.6, 1.1)  # direction towards its middle
LAMP_SIZE = 0.09  # of the lamp's distance: how soft shadows are
EXPOSURES = 48
INK = (32, 34, 38)
FONT = cv2.FONT_HERSHEY_SIMPLEX
WHITE = (232, 235, 239)  # the studio's floor in the lamp's light, and what is behind it


def cell() -> None:
    """The mock cell with a block lifted out of ten."""
    config = load_cell(DEFAULT_CELL)
    workspace = workspace_of(config)
    world = World(config, random_scene(10, workspace, np.random.default_rng(3)), seed=3)
    try:
        lift_the_highest(world)
        pieces = world.visible()
    finally:
        world.close()
    floor = studio_floor(workspace.table_z - FLOOR_DEPTH)
    X_base_view = looking((2.0, -1.15, 0.85), at=(0.29, -0.08, 0.04))
    save("cell.png", photograph([*pieces, floor], X_base_view))


def cases() -> None:
    """The nine challenge cases, a row for each level; what is to be fetched is red."""
    lens = scaled(LENS, 1 / 3)
    X_base_view = looking((0.66, -0.38, 0.36), at=(0.5, 0.0, -0.14))
    views = []
    for case in challenge_cases():
        scene = parse_scene(case.file.read_text(encoding="utf-8"))
        view = photograph([*lying(scene), studio_floor(CASES_MIDDLE[2])], X_base_view, lens)
        place, size = (14, 24), 0.5
        cv2.putText(view, case.file.stem, place, FONT, size, INK, 1, cv2.LINE_AA)
        views.append(view)
    rows = [np.hstack(views[start : start + 3]) for start in range(0, len(views), 3)]
    save("cases.png", np.vstack(rows))


def novel() -> None:
    """The novel objects, as they stand in alphabetical order."""
    objects = []
    for index, shape in enumerate(NOVEL.values()):
        row, column = divmod(index, 6)
        x, y = 0.14 * column - 0.35, 0.21 - 0.14 * row
        X_base_object = Transform(
            Rotation.from_euler("z", 30, degrees=True),
            np.array([x, y, -shape.vertices[:, 2].min()]),
        )
        rgb = PALETTE[index % len(PALETTE)]
        objects.append(SceneObject(shape=shape, X_base_object=X_base_object, rgb=rgb))
    X_base_view = looking((0.0, -0.95, 1.0), at=(0.0, -0.01, 0.0))
    pieces = lying(Scene(objects=tuple(objects)))
    save("novel.png", photograph([*pieces, studio_floor(0.0)], X_base_view))


def lying(scene: Scene) -> list[VisiblePiece]:
    """The scene's objects where the scene has them."""
    return [
        VisiblePiece(piece, item.X_base_object, item.rgb, index)
        for index, item in enumerate(scene.objects)
        for piece in item.shape.pieces
    ]


def scaled(lens: Intrinsics, scale: float) -> Intrinsics:
    """The same view in fewer pixels."""
    return Intrinsics(
        width=round(lens.width * scale),
        height=round(lens.height * scale),
        fx=lens.fx * scale,
        fy=lens.fy * scale,
        cx=(lens.cx + 0.5) * scale - 0.5,
        cy=(lens.cy + 0.5) * scale - 0.5,
    )


def lift_the_highest(world: World) -> None:
    """Grasp the highest object at its middle and raise it."""
    arm, gripper = SimArm(world), SimGripper(world)
    gripper.activate()
    block = max(world.objects(), key=lambda state: state.X_base_object.translation[2])
    x, y, z = block.X_base_object.translation
    yaw = float(block.X_base_object.rotation.as_euler("zyx")[0])
    for height in (z + 0.2, z - 0.01):
        arm.move_linear(top_down(x, y, height, yaw), speed=0.5, acceleration=1.2, deadline=20.0)
    gripper.move(0.0, speed=0.1, force=20.0)
    arm.move_linear(top_down(x, y, z + 0.16, yaw), speed=0.25, acceleration=1.2, deadline=20.0)


def studio_floor(z: float) -> VisiblePiece:
    """So large and bright that it has no horizon."""
    light = Lighting(direction=LAMP)
    lit = light.ambient + (1 - light.ambient) * light.towards_lamp[2]
    red, green, blue = (round(value / lit) for value in WHITE)
    piece = ConvexPiece.from_vertices(box(60.0, 60.0, 0.1, center=(0.0, 0.0, z - 0.049)))
    return VisiblePiece(piece, Transform.identity(), (red, green, blue), TABLE)


def looking(eye: tuple[float, float, float], *, at: tuple[float, float, float]) -> Transform:
    """Pose of an upright camera (optical axes) that looks from one point at another."""
    z = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z], axis=1)
    return Transform(Rotation.from_matrix(axes), np.array(eye))


def photograph(
    pieces: Sequence[VisiblePiece], X_base_view: Transform, lens: Intrinsics = LENS
) -> npt.NDArray[np.uint8]:
    """Smooth edges and soft shadows: the mean of exposures with the pixels' centres spread over
    the pixels, and the lamp over its disc."""
    rng = np.random.default_rng(0)
    total = np.zeros((lens.height, lens.width, 3))
    for _ in range(EXPOSURES):
        right, down = rng.uniform(-0.5, 0.5, 2)
        spread = replace(lens, cx=lens.cx + right, cy=lens.cy + down)
        x, y, z = Lighting(direction=LAMP).towards_lamp + rng.normal(0, LAMP_SIZE / 2, 3)
        light = Lighting(direction=(x, y, z), shadow_side=2.6, background=WHITE)
        total += render(pieces, spread, X_base_view, light).color
    return np.rint(total / EXPOSURES).astype(np.uint8)


def save(name: str, picture: npt.NDArray[np.uint8]) -> None:
    IMAGES.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(IMAGES / name), picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    cell()
    cases()
    novel()
