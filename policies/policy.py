"""A frozen policy: heightmap in, one push or grasp out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from policies.heightmap import Heightmap
from policies.primitives import Primitive

ROTATIONS = 16  # of pi / 8 (paper, section III)
HALF_TURN = ROTATIONS // 2  # a grasp and the bare fingers look the same after it


@dataclass(frozen=True, kw_only=True, eq=False)
class QMaps:
    """Action values. Index [k, row, col] is the action at that pixel of the *unrotated*
    heightmap with yaw = k * pi / 8.

    push, grasp: (16, 224, 224) float32; -inf where the action is not allowed.
    """

    push: npt.NDArray[np.float32]
    grasp: npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One entry of the Q-maps."""

    kind: Literal["grasp", "push"]
    rotation: int
    row: int
    col: int
    q: float


@dataclass(frozen=True, kw_only=True)
class CriticVerdict:
    """What Critic II said of Critic I's choice (paper, eq. 2 and section III-B).

    p_success: of the grasps that were considered. overruled: it swapped push and grasp.
    """

    p_success: tuple[float, ...]
    overruled: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Decision:
    """The chosen action, and why.

    rotation, row, col: its place in the Q-maps. q: its value.
    verdict: None for methods without Critic II. considered: grasps, best first. seconds: wall time
    by part. p_foreseen: how likely, by simulation, this push frees the goal, or this grasp takes
    it; None where simulation was not asked.
    """

    primitive: Primitive
    rotation: int
    row: int
    col: int
    q: float
    maps: QMaps
    verdict: CriticVerdict | None
    considered: tuple[Choice, ...] = ()
    seconds: dict[str, float]
    p_foreseen: float | None = None


class Decider(Protocol):
    """What the episode loop needs: trained policies, baselines and scripted ones alike."""

    def decide(
        self,
        heightmap: Heightmap,
        rng: np.random.Generator,
        *,
        avoid: Sequence[Primitive] = (),
    ) -> Decision:
        """The next action; none within reach of those in `avoid` (refused or futile ones).

        Raises NoActionError when nothing is left.
        """
