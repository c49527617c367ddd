"""An episode as a video: what was seen, valued and measured, in the robot's time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from policies.primitives import Push
from tdpg_deploy.episode_log.entries import Step
from tdpg_deploy.episode_log.pictures import draw_action, draw_goal, enlarge
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.errors import ConfigError, LogError
from tools.replay import telling

Picture = npt.NDArray[np.uint8]
Color = tuple[int, int, int]

FPS = 15
LONGEST = 600.0  # s of a motion that are shown
HOLD = 1.0  # s of the video before and after each motion
WIDTH, HEIGHT = 1280, 720
TOP = 56  # of the pictures
SEEN = (640, 360)  # the camera's picture
MAP = 320  # heightmap and action values
CHART = (24, 440, 1232, 130)  # left, top, width, height
MAX_FORCE, MAX_WIDTH = 60.0, 0.085  # N and m, at the chart's upper edge

PAPER: Color = (24, 26, 30)
INK: Color = (232, 232, 228)
FADED: Color = (140, 144, 150)
FORCE: Color = (236, 110, 90)
FINGERS: Color = (96, 170, 240)


def write_video(
    episode: Episode,
    path: Path,
    *,
    first: int,
    speed: float,
    on_damage: Callable[[LogError], None],
) -> int:
    """Write an .mp4 file (MPEG-4 part 2). Returns the number of its pictures.

    first: the step to begin with. speed: of the robot's motions. Raises ConfigError, and LogError
    if there is nothing to show.
    """
    if path.suffix != ".mp4":
        raise ConfigError(f"--video {path}: only .mp4 is written")
    part = path.with_name(f"{path.stem}.part.mp4")
    video = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*"mp4v"), FPS, (WIDTH, HEIGHT))
    if not video.isOpened():
        raise ConfigError(f"--video {path}: cannot be written")
    count = 0
    try:
        for picture in pictures(episode, first=first, speed=speed, on_damage=on_damage):
            video.write(np.ascontiguousarray(picture[..., ::-1]))
            count += 1
    finally:
        video.release()
        if count == 0:
            part.unlink(missing_ok=True)
    if count == 0:
        raise LogError(f"{episode.path}: no step {first} to show")
    part.replace(path)
    return count


def pictures(
    episode: Episode, *, first: int, speed: float, on_damage: Callable[[LogError], None]
) -> Iterator[Picture]:
    """(720, 1280, 3) RGB, FPS a second."""
    try:
        for number, step in enumerate(episode.steps(), start=1):
            if number >= first:
                yield from _step(step, f"{episode.path.name}   step {number}", speed)
    except LogError as error:
        on_damage(error)


def _step(step: Step, title: str, speed: float) -> Iterator[Picture]:
    page = _page(step, title)
    before = [line for line in telling.tell(step) if line[0] in ("refused", "decided", "planned")]
    after = [line for line in telling.tell(step) if line[0] in ("measured", "outcome")]
    held = round(HOLD * FPS)
    decided = _with_lines(page, before)
    yield from [decided] * held
    if step.tool_path:
        started, ended = step.tool_path[0].stamp, step.tool_path[-1].stamp
        for at in range(int(min(ended - started, LONGEST) / speed * FPS)):
            yield _with_traces(decided, step, started + at / FPS * speed)
        yield from [_with_traces(_with_lines(page, [*before, *after]), step, ended)] * held


# --- one picture ------------------------------------------------------------------------------


def _page(step: Step, title: str) -> Picture:
    """All that does not move during a step."""
    page = np.full((HEIGHT, WIDTH, 3), PAPER, np.uint8)
    _write(page, title, (24, 36), INK, 0.7)
    primitive = None if step.intent is None else step.intent.decision.primitive
    if step.look is not None:
        _place(page, step.look.frame.color, (0, TOP), SEEN)
        seen = enlarge(step.look.heightmap.color)
        if step.look.heightmap.goal is not None:
            draw_goal(seen, step.look.heightmap.goal)
        if primitive is not None:
            draw_action(seen, primitive, step.look.heightmap.workspace)
        _place(page, seen, (SEEN[0], TOP), (MAP, MAP))
    if step.q_pictures is not None:
        is_push = isinstance(primitive, Push)
        values = step.q_pictures.push if is_push else step.q_pictures.grasp
        _place(page, values, (SEEN[0] + MAP, TOP), (MAP, MAP))
        _write(page, f"value of {'pushes' if is_push else 'grasps'}", (968, 400), FADED, 0.5)
    _write(page, "heightmap and action", (648, 400), FADED, 0.5)
    left, top, width, height = CHART
    cv2.rectangle(page, (left, top), (left + width, top + height), FADED, 1)
    _write(page, f"force, to {MAX_FORCE:.0f} N", (left + 8, top + 18), FORCE, 0.45)
    _write(page, f"fingers, to {1000 * MAX_WIDTH:.0f} mm", (left + 150, top + 18), FINGERS, 0.45)
    return page


def _place(page: Picture, picture: Picture, at: tuple[int, int], size: tuple[int, int]) -> None:
    x, y = at
    width, height = size
    page[y : y + height, x : x + width] = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def _with_lines(page: Picture, lines: list[telling.Line]) -> Picture:
    written = page.copy()
    for row, (label, text) in enumerate(lines[-5:]):
        _write(written, label, (24, 602 + 25 * row), FADED, 0.5)
        _write(written, text[:140], (120, 602 + 25 * row), INK, 0.5)
    return written


def _with_traces(page: Picture, step: Step, until: float) -> Picture:
    """Force and width up to this time on the cell's clock."""
    drawn = page.copy()
    path = step.tool_path
    span = (path[0].stamp, path[-1].stamp)
    force = [(point.stamp, point.force / MAX_FORCE) for point in path]
    width = [(state.stamp, state.width / MAX_WIDTH) for state in step.gripper_states]
    for trace, color in ((force, FORCE), (_held(width, until), FINGERS)):
        points = [_on_chart(t, share, span) for t, share in trace if t <= until]
        if points:
            cv2.polylines(drawn, [np.array(points, np.int32)], False, color, 2, cv2.LINE_AA)
    return drawn


def _held(trace: list[tuple[float, float]], until: float) -> list[tuple[float, float]]:
    """The fingers are measured when they have moved: until the next time they stay so."""
    ends = [stamp for stamp, _ in trace[1:]]
    held = []
    for (stamp, share), end in zip(trace, [*ends, until], strict=False):
        held += [(stamp, share), (min(end, until), share)]
    return held


def _on_chart(stamp: float, share: float, span: tuple[float, float]) -> tuple[int, int]:
    left, top, width, height = CHART
    along = (stamp - span[0]) / max(span[1] - span[0], 1e-6)
    up = min(max(share, 0.0), 1.0)
    return left + round(width * min(max(along, 0.0), 1.0)), top + round(height * (1 - up))


def _write(page: Picture, text: str, at: tuple[int, int], color: Color, size: float) -> None:
    cv2.putText(page, text, at, cv2.FONT_HERSHEY_DUPLEX, size, color, 1, cv2.LINE_AA)
