"""Records of grasps -> what the critics of grasps are asked, and the answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from policies.heightmap import SIZE
from policies.networks.light import LightNet
from policies.rotation import around
from policies.state import stacked
from tools.train.cut import METRES, cut
from tools.train.grasps.play import GraspRecord
from tools.train.learner import augmented
from tools.train.replay import UNSEEN
from tools.train.teach import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspLessons:
    """heights, colors, inside: (n, PATCH, PATCH, ...) around grasps, turned so that they lead
    upwards; places: (n, 2) of the grasps in them, in [-1, 1]. answer: (n,) 1 for what held, else 0.
    look: (n,) what it was made from."""

    heights: npt.NDArray[np.uint16]
    colors: npt.NDArray[np.uint8]
    inside: npt.NDArray[np.bool_]
    places: Array
    answer: Array
    look: npt.NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.answer)

    def questions(
        self, picks: npt.NDArray[np.intp], rng: np.random.Generator | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Patches (k, 6, PATCH, PATCH) and places (k, 2), as LightNet is shown them. rng: under
        the symmetries of the task."""
        height, color = METRES[self.heights[picks]], self.colors[picks]
        cuts = torch.from_numpy(stacked(self.inside[picks], height, color, None))
        places = torch.from_numpy(self.places[picks])
        if rng is None:
            return cuts, places
        return augmented(cuts, places, np.zeros(len(picks), np.bool_), rng)


def lessons_of(records: Sequence[GraspRecord]) -> GraspLessons:
    """Of every grasp, whether it held."""
    parts = [_lessons(record) for record in records]
    first = np.cumsum([0, *(len(record.heights) for record in records)])
    return GraspLessons(
        heights=np.concatenate([part.heights for part in parts]),
        colors=np.concatenate([part.colors for part in parts]),
        inside=np.concatenate([part.inside for part in parts]),
        places=np.concatenate([part.places for part in parts]),
        answer=np.concatenate([part.answer for part in parts]),
        look=np.concatenate([part.look + n for part, n in zip(parts, first, strict=False)]),
    )


def _lessons(record: GraspRecord) -> GraspLessons:
    look, rotation, row, col = record.grasps.astype(np.intp).T
    index, places = around(
        *(torch.from_numpy(number) for number in (rotation, row, col)),
        size=LightNet.PATCH,
        stride=LightNet.STRIDE,
    )
    at = index.numpy()
    return GraspLessons(
        heights=cut(record.heights, look, at, int(UNSEEN)),
        colors=cut(record.colors, look, at, 0),
        inside=at != SIZE * SIZE,
        places=places.numpy(),
        answer=record.held.astype(np.float32),
        look=look,
    )
