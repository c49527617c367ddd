"""Scene files: TOML, read and written exactly. docs/scene-file.md explains every field.

A saved scene loads to the same bits: numbers are written with all their digits, and a
quaternion that is of unit length to the last digits is taken as it stands.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.spatial.transform import Rotation

from policies.heightmap import Workspace
from tdpg_deploy.errors import SceneError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.sim.bodies import SHAPES, Shape
from tdpg_deploy.sim.novel import NOVEL
from tdpg_deploy.sim.scenes import MAX_OBJECTS, Scene, SceneObject

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

NAMED_SHAPES: Mapping[str, Shape] = {**SHAPES, **NOVEL}

UNIT_BY_HAND = 1e-3  # |q| of a quaternion that somebody typed
UNIT_AS_SAVED = 1e-12  # |q| of one that a program wrote

_HEADER = """\
# A scene: what lies on the table. docs/scene-file.md explains every field.
version = 1
frame = "base"
length = "m"
quaternion = "xyzw"
"""

_Number = Annotated[float, Field(strict=True)]
_Byte = Annotated[int, Field(strict=True, ge=0, le=255)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Object(_Section):
    shape: str
    position: tuple[_Number, _Number, _Number]
    quaternion: tuple[_Number, _Number, _Number, _Number]
    rgb: tuple[_Byte, _Byte, _Byte]
    goal: Annotated[bool, Field(strict=True)] = False


class _File(_Section):
    version: Literal[1]
    frame: Literal["base"]
    length: Literal["m"]
    quaternion: Literal["xyzw"]
    object: Annotated[tuple[_Object, ...], Field(max_length=MAX_OBJECTS)] = ()


def load_scene(
    path: Path, workspace: Workspace, shapes: Mapping[str, Shape] = NAMED_SHAPES
) -> Scene:
    """Read a scene file. Raises SceneError that names each wrong field, and refuses objects
    outside of the workspace."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: not a text file: {error}") from error
    try:
        scene = parse_scene(text, shapes)
        scene.check(workspace)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    return scene


def save_scene(scene: Scene, path: Path) -> None:
    """Write a scene file. Raises SceneError."""
    try:
        path.write_text(format_scene(scene), encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror})") from error


def parse_scene(text: str, shapes: Mapping[str, Shape] = NAMED_SHAPES) -> Scene:
    """A scene from a file's text. Raises SceneError that names each wrong field."""
    try:
        file = _File.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"not a TOML file: {error}") from error
    except ValidationError as error:
        raise SceneError(_explain(error)) from error
    return Scene(
        objects=tuple(_object(item, f"object[{i}]", shapes) for i, item in enumerate(file.object))
    )


def format_scene(scene: Scene) -> str:
    """The file's text. Python's float literals are TOML's, and name each number exactly."""
    blocks = [_HEADER]
    for item in scene.objects:
        position = item.X_base_object.translation.tolist()
        quaternion = item.X_base_object.rotation.as_quat().tolist()
        blocks.append(
            "[[object]]\n"
            f'shape = "{item.shape.name}"\n'
            f"position = {position}\n"
            f"quaternion = {quaternion}\n"
            f"rgb = {list(item.rgb)}\n"
            f"goal = {str(item.goal).lower()}\n"
        )
    return "\n".join(blocks)


def _object(item: _Object, field: str, shapes: Mapping[str, Shape]) -> SceneObject:
    if item.shape not in shapes:
        raise SceneError(
            f'{field}.shape = "{item.shape}" is not one of {", ".join(sorted(shapes))}'
        )
    norm = float(np.linalg.norm(item.quaternion))
    if abs(norm - 1) > UNIT_BY_HAND:
        raise SceneError(
            f"{field}.quaternion = {list(item.quaternion)} has norm {norm:.4f}: "
            "give x, y, z, w of a unit quaternion"
        )
    rotation = Rotation(np.array(item.quaternion), normalize=abs(norm - 1) > UNIT_AS_SAVED)
    return SceneObject(
        shape=shapes[item.shape],
        X_base_object=Transform(rotation, np.array(item.position)),
        rgb=item.rgb,
        goal=item.goal,
    )


def _explain(error: ValidationError) -> str:
    lines = []
    for problem in error.errors():
        field = _name(problem["loc"])
        if problem["type"] == "extra_forbidden":
            lines.append(f"{field}: unknown key; docs/scene-file.md lists what exists")
        elif problem["type"] == "missing":
            lines.append(f"{field}: missing")
        else:
            given: Any = problem["input"]
            shown = "" if isinstance(given, dict | list) else f" = {given!r}"
            lines.append(f"{field}{shown}: {problem['msg']}")
    return "; ".join(lines)


def _name(loc: tuple[int | str, ...]) -> str:
    """object[2].position[0]"""
    name = ""
    for part in loc:
        name += f"[{part}]" if isinstance(part, int) else f".{part}"
    return name.removeprefix(".") or "scene"
