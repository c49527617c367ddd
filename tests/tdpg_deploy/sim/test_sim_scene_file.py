from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from policies.heightmap import Workspace
from tdpg_deploy.errors import SceneError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.sim.bodies import SHAPES, Shape, box
from tdpg_deploy.sim.scene_file import format_scene, load_scene, parse_scene, save_scene
from tdpg_deploy.sim.scenes import PALETTE, Scene, SceneObject, random_scene

WORKSPACE = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)

GOOD = """
version = 1
frame = "base"
length = "m"
quaternion = "xyzw"

[[object]]
shape = "cube"
position = [0.5, 0.1, -0.125]
quaternion = [0, 0, 0.70711, 0.70711]
rgb = [255, 0, 10]
goal = true
"""

coordinate = st.floats(-10, 10)
turn = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
scene_object = st.builds(
    SceneObject,
    shape=st.sampled_from(list(SHAPES.values())),
    X_base_object=st.builds(
        Transform.from_quaternion, st.tuples(coordinate, coordinate, coordinate), turn
    ),
    rgb=st.tuples(*[st.integers(0, 255)] * 3),
    goal=st.booleans(),
)


def bits(scene: Scene) -> list[tuple[object, ...]]:
    return [
        (
            item.shape.name,
            item.X_base_object.translation.tobytes(),
            item.X_base_object.rotation.as_quat().tobytes(),
            item.rgb,
            item.goal,
        )
        for item in scene.objects
    ]


@given(st.lists(scene_object, max_size=4))
def test_a_saved_scene_loads_to_the_same_bits(objects: list[SceneObject]) -> None:
    scene = Scene(objects=tuple(objects))
    assert bits(parse_scene(format_scene(scene))) == bits(scene)


def test_the_file_on_disk_is_exact_too(tmp_path: Path) -> None:
    scene = random_scene(30, WORKSPACE, np.random.default_rng(1))
    save_scene(scene, tmp_path / "heap.toml")
    assert bits(load_scene(tmp_path / "heap.toml", WORKSPACE)) == bits(scene)


def test_a_scene_written_by_hand() -> None:
    (item,) = parse_scene(GOOD).objects
    assert item.shape is SHAPES["cube"]
    assert item.rgb == (255, 0, 10)
    assert item.goal
    expected = Transform(Rotation.from_euler("z", 90, degrees=True), np.array([0.5, 0.1, -0.125]))
    assert item.X_base_object.distance(expected) == pytest.approx((0, 0), abs=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0.5, 0.1, -0.125]", "[nan, 0.1, -0.125]", "object[0].position[0] = nan"),
        ("[0.5, 0.1, -0.125]", "[0.5, 0.1]", "object[0].position[2]: missing"),
        ("[0.5, 0.1, -0.125]", '["0.5", 0.1, -0.125]', "object[0].position[0] = '0.5'"),
        ("[0, 0, 0.70711, 0.70711]", "[0, 0, 0.8, 0.8]", "object[0].quaternion"),
        ("[0, 0, 0.70711, 0.70711]", "[0, 0, 0, inf]", "object[0].quaternion[3] = inf"),
        ('shape = "cube"', 'shape = "ball"', 'object[0].shape = "ball" is not one of arch, bar'),
        ('shape = "cube"', "", "object[0].shape: missing"),
        ("[255, 0, 10]", "[256, 0, 10]", "object[0].rgb[0] = 256"),
        ("[255, 0, 10]", "[0.5, 0, 10]", "object[0].rgb[0] = 0.5"),
        ("goal = true", "goal = 1", "object[0].goal = 1"),
        ("goal = true", "target = true", "object[0].target: unknown key"),
        ("version = 1", "version = 2", "version = 2"),
        ("version = 1", "", "version: missing"),
        ('frame = "base"', 'frame = "world"', "frame = 'world'"),
        ('length = "m"', 'length = "mm"', "length = 'mm'"),
        ('quaternion = "xyzw"', 'quaternion = "wxyz"', "quaternion = 'wxyz'"),
        ("version = 1", "version = ", "not a TOML file"),
    ],
)
def test_a_wrong_file_is_refused_by_field(old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(SceneError) as error:
        parse_scene(GOOD.replace(old, new, 1))
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("position", "message"),
    [
        ("[0.5, 0.23, -0.125]", "outside of the workspace x [0.276, 0.724], y [-0.224, 0.224]"),
        ("[0.5, 0.1, -0.2]", "z = -0.200 m is not 0 to 2 m above the table"),
    ],
)
def test_an_object_outside_of_the_workspace_is_refused(
    tmp_path: Path, position: str, message: str
) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(GOOD.replace("[0.5, 0.1, -0.125]", position))
    with pytest.raises(SceneError) as error:
        load_scene(file, WORKSPACE)
    assert message in str(error.value)
    assert str(file) in str(error.value)


def test_shapes_of_ones_own(tmp_path: Path) -> None:
    hammer = Shape.from_hulls(
        "hammer",
        [box(0.02, 0.1, 0.02), box(0.08, 0.02, 0.02, center=(0, 0.06, 0))],
    )
    item = SceneObject(
        shape=hammer,
        X_base_object=Transform.from_quaternion((0.5, 0, -0.1), (0, 0, 0, 1)),
        rgb=(9, 9, 9),
    )
    save_scene(Scene(objects=(item,)), tmp_path / "hammer.toml")
    with pytest.raises(SceneError, match=r'object\[0\].shape = "hammer" is not one of'):
        load_scene(tmp_path / "hammer.toml", WORKSPACE)
    shapes = {**SHAPES, "hammer": hammer}
    (loaded,) = load_scene(tmp_path / "hammer.toml", WORKSPACE, shapes).objects
    assert loaded.shape is hammer


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="cannot be read"):
        load_scene(tmp_path / "absent.toml", WORKSPACE)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match="not a text file"):
        load_scene(tmp_path / "binary.toml", WORKSPACE)
    with pytest.raises(SceneError, match="cannot be written"):
        save_scene(Scene(objects=()), tmp_path / "no" / "folder.toml")


@pytest.mark.parametrize("n", [0, 31])
def test_heaps_of_impossible_size(n: int) -> None:
    with pytest.raises(SceneError, match=f"{n} objects"):
        random_scene(n, WORKSPACE, np.random.default_rng(0))


@pytest.mark.parametrize("seed", range(3))
def test_objects_fall_from_apart(seed: int) -> None:
    scene = random_scene(30, WORKSPACE, np.random.default_rng(seed))
    scene.check(WORKSPACE)
    boxes = []
    for item in scene.objects:
        corners = item.X_base_object @ item.shape.vertices
        boxes.append((corners.min(axis=0), corners.max(axis=0)))
        assert boxes[-1][0][2] > WORKSPACE.table_z
        assert item.rgb in PALETTE
    for i, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:i]:
            assert (low > other_high).any() or (other_low > high).any()


def test_same_seed_same_heap() -> None:
    one, two = (random_scene(10, WORKSPACE, np.random.default_rng(4)) for _ in range(2))
    assert bits(one) == bits(two)
