"""An episode -> the frames of a dataset: one for each action that was concluded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from policies.heightmap import Heightmap
from policies.primitives import Primitive, Push
from tdpg_deploy.episode_log.entries import Conclusion, Intent, Look
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.hal import ArmState
from tdpg_deploy.outcome import Verdict

Picture = npt.NDArray[np.uint8]

ACTION_NAMES = ("push", "x", "y", "z", "yaw", "length")  # 0 or 1; m in base; rad; m, 0 of a grasp


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """What was seen, and the action that followed.

    camera: (H, W, 3) uint8 RGB. map_color: (224, 224, 3) uint8 RGB, the heightmap's. map_height:
    (224, 224, 3) uint8: millimetres above the table (0 to 255), 255 where seen, 255 on the goal.
    state: (6,) rad, the joints as the motion began. action: (6,), see ACTION_NAMES. task: in words.
    """

    camera: Picture
    map_color: Picture
    map_height: Picture
    state: npt.NDArray[np.float32]
    action: npt.NDArray[np.float32]
    success: bool
    task: str


def frames(episode: Episode) -> Iterator[Frame]:
    """Holds two looks in memory. Raises LogError at damage, after the frames that lie before it.

    An action is left out whose look or outcome is lost, during which the arm told no state, or
    which is not made of numbers.
    """
    look: Look | None = None
    before: Look | None = None
    intent: Intent | None = None
    state: ArmState | None = None
    for entry in episode.entries():
        if isinstance(entry, Look):
            look = entry
        elif isinstance(entry, Intent):
            before, intent, state = look, entry, None
        elif isinstance(entry, ArmState):
            state = state or entry
        elif isinstance(entry, Conclusion):
            if before is not None and intent is not None and state is not None:
                success = entry.outcome.success is Verdict.YES
                frame = _frame(before, intent.decision.primitive, state, success)
                if np.isfinite([*frame.state, *frame.action]).all():
                    yield frame
            intent = None


@np.errstate(over="ignore")  # what does not fit becomes infinite
def _frame(look: Look, primitive: Primitive, state: ArmState, success: bool) -> Frame:
    heightmap = look.heightmap
    return Frame(
        camera=look.frame.color,
        map_color=heightmap.color,
        map_height=height_picture(heightmap),
        state=state.q.astype(np.float32),
        action=action_of(primitive),
        success=success,
        task="clear the table" if heightmap.goal is None else "fetch the marked object",
    )


def height_picture(heightmap: Heightmap) -> Picture:
    """(224, 224, 3) uint8: millimetres above the table, 255 where seen, 255 on the goal."""
    goal = np.zeros(heightmap.valid.shape) if heightmap.goal is None else heightmap.goal
    millimetres = np.nan_to_num(1000 * heightmap.height).round().clip(0, 255)
    return np.stack([millimetres, 255 * heightmap.valid, 255 * goal], axis=-1).astype(np.uint8)


def action_of(primitive: Primitive) -> npt.NDArray[np.float32]:
    """(6,), as ACTION_NAMES has it."""
    p = primitive
    length = p.length if isinstance(p, Push) else 0.0
    return np.array([isinstance(p, Push), p.x, p.y, p.z, p.yaw, length], np.float32)
