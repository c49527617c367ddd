"""Experience on disk: looks (heightmaps) and transitions between them.

Memory-mapped, so that a run of tens of thousands of looks fits anywhere. What belongs to the
run after a kill is what `state` said when the training state was last saved.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from policies.heightmap import SIZE

HEIGHT_STEP = 1e-4  # m a count; the camera's noise is ten times as large
HEIGHT_OFFSET = 0.1  # m below the table that can still be stored
UNSEEN = np.uint16(65535)
CANDIDATES = 10  # best grasps of the next look, kept so that its value can be refreshed

TRANSITION = np.dtype(
    [
        ("look", "i4"),
        ("next_look", "i4"),  # -1 at the end of a trial
        ("push", "?"),
        ("rotation", "i2"),
        ("row", "i2"),
        ("col", "i2"),
        ("reward", "f4"),
        ("grasped", "i1"),  # label of Critic II: 1, 0, or -1 where no grasp was tried
        ("next_grasps", "i2", (CANDIDATES, 3)),  # rotation, row, col
        ("next_push", "i2", 3),  # the best push of the next look; -1 where none is allowed
    ]
)


def pack_height(height: npt.NDArray[np.float32]) -> npt.NDArray[np.uint16]:
    """Metres, nan where unseen -> counts of 0.1 mm."""
    counts = np.round((np.nan_to_num(height) + HEIGHT_OFFSET) / HEIGHT_STEP)
    packed = np.clip(counts, 0, UNSEEN - 1).astype(np.uint16)
    packed[~np.isfinite(height)] = UNSEEN
    return packed


def unpack_height(packed: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    height = packed.astype(np.float32) * HEIGHT_STEP - HEIGHT_OFFSET
    height[packed == UNSEEN] = np.nan
    return height.astype(np.float32)


def pack_goal(goal: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    """(224, 224) -> (224, 28): eight pixels a byte."""
    return np.packbits(goal, axis=1)


def unpack_goal(packed: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    return np.unpackbits(packed, axis=1).astype(np.bool_)


class Replay:
    """Looks and transitions in a directory; `capacity` of each at most.

    goals: None where tables are cleared.
    """

    def __init__(self, directory: Path, capacity: int, *, goal: bool = False) -> None:
        directory.mkdir(parents=True, exist_ok=True)

        def array(name: str, dtype: npt.DTypeLike, *shape: int) -> np.memmap[Any, Any]:
            mode: Any = "r+" if (directory / name).exists() else "w+"
            return np.memmap(directory / name, dtype, mode, shape=(capacity, *shape))

        self.heights = array("heights.u16", np.uint16, SIZE, SIZE)
        self.colors = array("colors.u8", np.uint8, SIZE, SIZE, 3)
        self.goals = array("goals.bits", np.uint8, SIZE, SIZE // 8) if goal else None
        self.transitions = array("transitions.bin", TRANSITION)
        self.priorities = np.zeros(capacity, np.float32)
        self.looks = 0
        self.size = 0

    def state(self) -> dict[str, Any]:
        """What must be saved with the weights; the arrays themselves are on disk by now."""
        for array in (self.heights, self.colors, self.goals, self.transitions):
            if array is not None:
                array.flush()
        return {
            "looks": self.looks,
            "size": self.size,
            "priorities": self.priorities[: self.size].tolist(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Forget whatever was added after `state` was taken."""
        self.looks, self.size = state["looks"], state["size"]
        self.priorities[: self.size] = state["priorities"]

    def extend(
        self,
        heights: npt.NDArray[np.uint16],
        colors: npt.NDArray[np.uint8],
        transitions: npt.NDArray[np.void],
        goals: npt.NDArray[np.uint8] | None = None,
    ) -> None:
        """Add packed looks, and transitions whose looks are indices into them.

        New transitions are as urgent as the most urgent: each is likely to be seen once.
        """
        looks = slice(self.looks, self.looks + len(heights))
        added = slice(self.size, self.size + len(transitions))
        self.heights[looks], self.colors[looks] = heights, colors
        if self.goals is not None:
            assert goals is not None, "each look of this run shows a goal"
            self.goals[looks] = goals
        transitions = transitions.copy()
        transitions["look"] += self.looks
        transitions["next_look"] += np.where(transitions["next_look"] >= 0, self.looks, 0)
        self.transitions[added] = transitions
        self.priorities[added] = self.priorities[: self.size].max() if self.size else 1.0
        self.looks, self.size = looks.stop, added.stop

    def sample(
        self, batch: int, rng: np.random.Generator, *, exponent: float, importance: float
    ) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float32]]:
        """Proportional prioritized sampling (Schaul et al. 2016, section 3.3).

        Returns indices (batch,) and importance weights (batch,), the largest being 1.
        """
        weights = self.priorities[: self.size].astype(np.float64) ** exponent
        cumulative = np.cumsum(weights)
        picks = np.searchsorted(cumulative, rng.random(batch) * cumulative[-1], side="right")
        probability = weights[picks] / cumulative[-1]
        correction = (self.size * probability) ** -importance
        return picks, (correction / correction.max()).astype(np.float32)

    def reprioritize(self, picks: npt.NDArray[np.intp], errors: npt.NDArray[np.float32]) -> None:
        """|TD error| of what was just learnt from; the floor keeps everything reachable."""
        self.priorities[picks] = np.abs(errors) + 0.01
