"""Write a LeRobotDataset: Parquet with PNG pictures inside, as lerobot 0.4 reads it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import pyarrow as pa
import pyarrow.parquet as pq

from tdpg_deploy.episode_log.lerobot import layout
from tdpg_deploy.episode_log.lerobot.frames import Frame, Picture
from tdpg_deploy.episode_log.lerobot.stats import PictureStats, of_vectors
from tdpg_deploy.errors import LogError

BATCH = 16  # frames in memory


class DatasetWriter:
    """Writes episodes into a new folder, and holds BATCH frames of them in memory.

    frames: how many were written so far. What lerobot reads is complete after `__exit__`.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.frames = 0
        self._rows: list[dict[str, Any]] = []
        self._columns: dict[str, list[Any]] = {}  # without pictures
        self._pictures = {
            name: PictureStats() for name in (layout.CAMERA, layout.MAP_COLOR, layout.MAP_HEIGHT)
        }
        self._shape: tuple[int, ...] | None = None  # of the camera's pictures
        self._tasks: list[str] = []
        self._episodes: list[dict[str, Any]] = []
        self._file = 0
        self._data: pq.ParquetWriter | None = None

    def __enter__(self) -> DatasetWriter:
        """Raises LogError if the folder exists or cannot be made."""
        try:
            self._folder.mkdir(parents=True)
        except OSError as error:
            raise LogError(f"{self._folder}: no new folder ({error.strerror})") from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._data is not None:
            self._data.close()
        if not self._episodes and self._data is None:
            self._folder.rmdir()
        elif error is None:
            self._write_meta()

    def add(self, frames: Iterable[Frame]) -> int:
        """One episode. Returns the number of its frames; one without any is left out.

        Raises LogError for pictures of another size than those before, and what `frames` raises;
        the frames before stay.
        """
        first, file, tasks = self.frames, self._file, set[str]()
        pending: Frame | None = None
        try:
            for frame in frames:
                if pending is not None:
                    self._add(pending, first, is_last=False)
                self._check_shape(frame.camera)
                pending = frame
                tasks.add(frame.task)
        finally:
            if pending is not None:
                self._add(pending, first, is_last=True)
                self._end_episode(first, file, tasks)
        return self.frames - first

    def _check_shape(self, picture: Picture) -> None:
        self._shape = self._shape or picture.shape
        if picture.shape != self._shape:
            raise LogError(
                f"camera pictures of {picture.shape[1]}x{picture.shape[0]} after such of "
                f"{self._shape[1]}x{self._shape[0]} pixels: a dataset has one size"
            )

    def _add(self, frame: Frame, first: int, *, is_last: bool) -> None:
        if frame.task not in self._tasks:
            self._tasks.append(frame.task)
        number = self.frames - first
        columns = {
            layout.STATE: frame.state.tolist(),
            layout.ACTION: frame.action.tolist(),
            layout.REWARD: float(frame.success),
            layout.SUCCESS: frame.success,
            layout.DONE: is_last,
            "timestamp": number / layout.FPS,
            "frame_index": number,
            "episode_index": len(self._episodes),
            "index": self.frames,
            "task_index": self._tasks.index(frame.task),
        }
        for name, value in columns.items():
            self._columns.setdefault(name, []).append(value)
        pictures = {
            layout.CAMERA: frame.camera,
            layout.MAP_COLOR: frame.map_color,
            layout.MAP_HEIGHT: frame.map_height,
        }
        for name, picture in pictures.items():
            self._pictures[name].add(picture)
        encoded = {name: {"bytes": _png(each), "path": None} for name, each in pictures.items()}
        self._rows.append(columns | encoded)
        self.frames += 1
        if len(self._rows) == BATCH:
            self._flush()

    def _flush(self) -> None:
        if not self._rows:
            return
        if self._data is None:
            path = self._folder / layout.DATA_PATH.format(**layout.place(self._file))
            path.parent.mkdir(parents=True, exist_ok=True)
            self._data = pq.ParquetWriter(path, layout.FRAMES)
        self._data.write_table(pa.Table.from_pylist(self._rows, schema=layout.FRAMES))
        self._rows = []

    def _end_episode(self, first: int, file: int, tasks: set[str]) -> None:
        self._flush()
        place = layout.place(file)
        self._episodes.append(
            {
                "episode_index": len(self._episodes),
                "tasks": sorted(tasks),
                "length": self.frames - first,
                "dataset_from_index": first,
                "dataset_to_index": self.frames,
                "data/chunk_index": place["chunk_index"],
                "data/file_index": place["file_index"],
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
        )
        path = self._folder / layout.DATA_PATH.format(**place)
        if self._data is not None and path.stat().st_size > layout.FILE_SIZE:
            self._data.close()
            self._data = None
            self._file += 1

    def _write_meta(self) -> None:
        meta = self._folder / "meta"
        episodes = self._folder / layout.EPISODES_PATH
        episodes.parent.mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(self._episodes, schema=layout.EPISODES), episodes)
        pq.write_table(layout.tasks_table(self._tasks), meta / "tasks.parquet")
        stats = {name: of_vectors(values) for name, values in self._columns.items()}
        stats |= {name: each.stats() for name, each in self._pictures.items()}
        _write_json(meta / "stats.json", stats)
        _write_json(meta / "info.json", self._info())

    def _info(self) -> dict[str, Any]:
        return {
            "codebase_version": layout.VERSION,
            "robot_type": "ur5",
            "total_episodes": len(self._episodes),
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
            "chunks_size": layout.CHUNK,
            "data_files_size_in_mb": layout.FILE_SIZE >> 20,
            "video_files_size_in_mb": layout.FILE_SIZE >> 20,
            "fps": layout.FPS,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": layout.DATA_PATH,
            "video_path": None,
            "features": layout.features(self._shape or ()),
        }


def _png(picture: Picture) -> bytes:
    done, png = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    assert done
    return png.tobytes()


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
