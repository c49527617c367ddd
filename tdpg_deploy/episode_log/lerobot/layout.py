"""How a LeRobotDataset, format v3.0, is laid out: files, features and Parquet schemas.

Stated by lerobot/datasets/utils.py of https://github.com/huggingface/lerobot, release 0.4.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import pyarrow as pa

from tdpg_deploy.episode_log.lerobot.frames import ACTION_NAMES
from tdpg_deploy.episode_log.messages import JOINT_NAMES

VERSION = "v3.0"
FPS = 1  # nominal: a frame is a decision, and they come when the motion before is over
CHUNK = 1000  # files of a folder
FILE_SIZE = 100 << 20  # bytes after which another file begins
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"

CAMERA, MAP_COLOR, MAP_HEIGHT = (
    f"observation.images.{name}" for name in ("camera", "heightmap", "height")
)
STATE, ACTION = "observation.state", "action"
REWARD, SUCCESS, DONE = "next.reward", "next.success", "next.done"
_PICTURE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
FRAMES = pa.schema(
    [
        *((name, _PICTURE) for name in (CAMERA, MAP_COLOR, MAP_HEIGHT)),
        (STATE, pa.list_(pa.float32(), len(JOINT_NAMES))),
        (ACTION, pa.list_(pa.float32(), len(ACTION_NAMES))),
        (REWARD, pa.float32()),
        (SUCCESS, pa.bool_()),
        (DONE, pa.bool_()),
        ("timestamp", pa.float32()),
        *((name, pa.int64()) for name in ("frame_index", "episode_index", "index", "task_index")),
    ]
)
EPISODES = pa.schema(
    [
        ("episode_index", pa.int64()),
        ("tasks", pa.list_(pa.string())),
        *(
            (name, pa.int64())
            for name in (
                "length", "dataset_from_index", "dataset_to_index", "data/chunk_index",
                "data/file_index", "meta/episodes/chunk_index", "meta/episodes/file_index",
            )
        ),
    ]
)  # fmt: skip


def place(file: int) -> dict[str, int]:
    """What DATA_PATH calls the file of this number."""
    return {"chunk_index": file // CHUNK, "file_index": file % CHUNK}


def features(camera: tuple[int, ...]) -> dict[str, Any]:
    """As meta/info.json has them. camera: shape of its pictures."""

    def feature(dtype: str, shape: tuple[int, ...], names: Iterable[str] | None) -> dict[str, Any]:
        return {"dtype": dtype, "shape": list(shape), "names": names and list(names)}

    axes = ("height", "width", "channels")
    vectors = {STATE: JOINT_NAMES, ACTION: ACTION_NAMES}
    pictures = {CAMERA: camera, MAP_COLOR: (224, 224, 3), MAP_HEIGHT: (224, 224, 3)}
    return {
        **{name: feature("image", shape, axes) for name, shape in pictures.items()},
        **{name: feature("float32", (len(names),), names) for name, names in vectors.items()},
        **{
            field.name: feature(_DTYPES[field.type], (1,), None)
            for field in FRAMES
            if field.type in _DTYPES
        },
    }


_DTYPES = {pa.float32(): "float32", pa.bool_(): "bool", pa.int64(): "int64"}


def tasks_table(tasks: list[str]) -> pa.Table:
    """As pandas writes a table whose index is the task: lerobot reads it by pandas."""
    index = "__index_level_0__"
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), index: tasks})
    columns = [
        {"name": name, "field_name": field, "pandas_type": kind, "numpy_type": dtype,
         "metadata": None}
        for name, field, kind, dtype in (
            ("task_index", "task_index", "int64", "int64"), (None, index, "unicode", "object"),
        )
    ]  # fmt: skip
    pandas = {
        "index_columns": [index],
        "column_indexes": [
            {"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object",
             "metadata": {"encoding": "UTF-8"}}
        ],
        "columns": columns,
        "pandas_version": "2.0.0",
    }  # fmt: skip
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})
