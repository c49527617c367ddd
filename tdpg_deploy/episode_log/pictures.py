"""Pictures that explain a decision: the heightmap, its Q-maps and the chosen action. Pure.

Up is base +x and left is base +y, as in a heightmap.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from policies.gripper import OPEN_WIDTH
from policies.heightmap import PIXEL, Heightmap, Workspace
from policies.policy import Decision
from policies.primitives import Primitive, Push
from tdpg_deploy.episode_log.channels import Q_GRASP, Q_PUSH

Picture = npt.NDArray[np.uint8]

SCALE = 2  # screen pixels a heightmap pixel
WHITE = (255, 255, 255)
BLACK = (0, 0, 0)
GOAL = (0, 230, 230)
FAR = 100.0  # m, and rad: nothing is drawn of an action beyond
_SUBPIXEL = 4  # bits; OpenCV draws with fixed-point coordinates


def enlarge(picture: Picture, scale: int = SCALE) -> Picture:
    """Each pixel becomes scale x scale of the same value."""
    return picture.repeat(scale, axis=0).repeat(scale, axis=1)


def q_maps(heightmap: Heightmap, decision: Decision) -> dict[str, Picture]:
    """Topic -> (448, 448, 3) RGB: best value over rotations, on one scale for both kinds.

    The chosen action is drawn on the map of its kind. Grey where no rotation is allowed.
    """
    best = {Q_PUSH: decision.maps.push.max(axis=0), Q_GRASP: decision.maps.grasp.max(axis=0)}
    allowed = np.concatenate([values[np.isfinite(values)] for values in best.values()])
    low, high = (float(allowed.min()), float(allowed.max())) if allowed.size else (0.0, 1.0)
    chosen = Q_PUSH if isinstance(decision.primitive, Push) else Q_GRASP
    pictures = {}
    for topic, values in best.items():
        picture = enlarge(_colored(values, low, high, heightmap.color))
        if heightmap.goal is not None:
            draw_goal(picture, heightmap.goal)
        if topic == chosen:
            draw_action(picture, decision.primitive, heightmap.workspace)
        pictures[topic] = picture
    return pictures


def _colored(values: npt.NDArray[np.float32], low: float, high: float, under: Picture) -> Picture:
    allowed = np.isfinite(values)
    span = max(high - low, 1e-6)
    level = np.where(allowed, (values - low) / span, 0.0).clip(0, 1)
    index = (level * 255).astype(np.uint8)
    heat = cv2.applyColorMap(index, cv2.COLORMAP_INFERNO)[..., ::-1].astype(np.float32)
    grey = np.repeat(under.mean(axis=-1, keepdims=True), 3, axis=-1)
    weight = np.where(allowed, 0.45 + 0.45 * level, 0.0)[..., None]
    return np.asarray(weight * heat + (1 - weight) * 0.55 * grey, np.uint8)


def draw_goal(picture: Picture, goal: npt.NDArray[np.bool_]) -> None:
    """Draw the outline of the goal's pixels, (224, 224) bool, into (n, n, 3) RGB."""
    scale = len(picture) // len(goal)
    mask = enlarge(goal.astype(np.uint8), scale)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, outlines, -1, GOAL, 2)


def draw_action(picture: Picture, primitive: Primitive, workspace: Workspace) -> None:
    """Draw into (n, n, 3) RGB: an arrow for a push, two fingers and their line for a grasp."""
    length = primitive.length if isinstance(primitive, Push) else 0.0
    if not np.all(np.abs([primitive.x, primitive.y, primitive.yaw, length]) < FAR):
        return  # a log may hold any number
    direction = np.array([np.cos(primitive.yaw), np.sin(primitive.yaw)])
    p_base = np.array([primitive.x, primitive.y])
    if isinstance(primitive, Push):
        start = _on_screen(p_base, workspace, picture)
        end = _on_screen(p_base + primitive.length * direction, workspace, picture)
        for color, width in ((BLACK, 5), (WHITE, 2)):
            _arrow(picture, start, end, color, width)
        return
    ends = [p_base - OPEN_WIDTH / 2 * direction, p_base + OPEN_WIDTH / 2 * direction]
    a, b = (_on_screen(end, workspace, picture) for end in ends)
    across = (b - a)[::-1] * [1, -1] * 0.18
    for color, width in ((BLACK, 5), (WHITE, 2)):
        _line(picture, a, b, color, width)
        for end in (a, b):
            _line(picture, end - across, end + across, color, width + 1)


def _on_screen(
    p_base: npt.NDArray[np.float64], workspace: Workspace, picture: Picture
) -> npt.NDArray[np.float64]:
    """x, y in base (m) -> column, row of the picture."""
    scale = len(picture) / (workspace.side / PIXEL)
    offset = np.array([workspace.y_max - p_base[1], workspace.x_max - p_base[0]])
    return np.asarray(offset / PIXEL * scale - 0.5, np.float64)


def _line(picture: Picture, a: Any, b: Any, color: tuple[int, int, int], width: int) -> None:
    cv2.line(picture, _fixed(a), _fixed(b), color, width, cv2.LINE_AA, _SUBPIXEL)


def _arrow(picture: Picture, a: Any, b: Any, color: tuple[int, int, int], width: int) -> None:
    cv2.arrowedLine(
        picture, _fixed(a), _fixed(b), color, width, cv2.LINE_AA, _SUBPIXEL, tipLength=0.25
    )


def _fixed(point: npt.NDArray[np.float64]) -> tuple[int, int]:
    x, y = np.round(point * (1 << _SUBPIXEL)).astype(int)
    return int(x), int(y)
