"""An episode as a video: what was seen, valued and measured, in the robot's time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import wrap

import cv2
import numpy as np
import numpy.typing as npt

from policies.primitives import Push
from tdpg_deploy.episode_log.entries import Step
from tdpg_deploy.episode_log.pictures import draw_action, draw_goal, enlarge
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.errors import ConfigError, LogError
from tdpg_deploy.outcome import Verdict
from tools.replay import telling
from tools.replay.telling import Line

Picture = npt.NDArray[np.uint8]
Color = tuple[int, int, int]

FPS = 15
LONGEST = 600.0  # s of a motion that are shown
HOLD = 1.0  # s of the video before and after each motion
WIDTH, HEIGHT = 1280, 720
SIDE = 320  # of heightmap and action values, and the height of the camera's picture
TOP = 56  # of the pictures
COLUMNS = ((24, 569), (605, SIDE), (937, SIDE))  # left, width
CHART = (72, 424, 1136, 124)  # left, top, width, height
MAX_FORCE, MAX_WIDTH = 60.0, 0.085  # N and m, at the chart's upper edge
TEXT, LINE, LINES = 596, 23, 6  # foot of the first line, height of each, how many
ROOM = 136  # letters in a line

PAPER: Color = (24, 26, 30)
GRID: Color = (58, 62, 68)
INK: Color = (232, 232, 228)
FADED: Color = (140, 144, 150)
FORCE: Color = (236, 110, 90)
FINGERS: Color = (96, 170, 240)
OUTCOMES: dict[str, Color] = {
    telling.WORDS[Verdict.YES]: (96, 200, 130),
    telling.WORDS[Verdict.NO]: (236, 110, 90),
    telling.WORDS[Verdict.UNKNOWN]: (232, 190, 90),
}


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
        raise ConfigError(
            f"--video {path}: cannot be written: is there such a folder, and may you?"
        )
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
        for number, (step, lines) in enumerate(telling.tell_each(episode), start=1):
            if number >= first:
                yield from _step(step, lines, f"{episode.path.stem}   step {number}", speed)
    except LogError as error:
        on_damage(error)


def _step(step: Step, lines: list[Line], title: str, speed: float) -> Iterator[Picture]:
    page = _page(step, title)
    before = [line for line in lines if line[0] in ("refused", "decided", "planned")]
    after = [line for line in lines if line[0] in ("measured", "outcome", "why")]
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
    _write(page, title, (24, 38), INK, 0.7)
    primitive = None if step.intent is None else step.intent.decision.primitive
    is_push = isinstance(primitive, Push)
    camera, seen, values = COLUMNS
    if step.look is not None:
        _place(page, step.look.frame.color, camera)
        picture = enlarge(step.look.heightmap.color)
        if step.look.heightmap.goal is not None:
            draw_goal(picture, step.look.heightmap.goal)
        if primitive is not None:
            draw_action(picture, primitive, step.look.heightmap.workspace)
        _place(page, picture, seen)
    if step.q_pictures is not None:
        _place(page, step.q_pictures.push if is_push else step.q_pictures.grasp, values)
    captions = ("camera", "heightmap and action", f"value of {'pushes' if is_push else 'grasps'}")
    for caption, (left, _) in zip(captions, COLUMNS, strict=True):
        _write(page, caption, (left, TOP + SIDE + 22), FADED, 0.5)
    _draw_axes(page, step)
    return page


def _draw_axes(page: Picture, step: Step) -> None:
    left, top, width, height = CHART
    right, bottom = left + width, top + height
    cv2.rectangle(page, (left, top), (right, bottom), GRID, 1)
    seconds = step.tool_path[-1].stamp - step.tool_path[0].stamp if step.tool_path else 0.0
    for second in range(1, int(min(seconds, LONGEST)) + 1):
        x = left + round(width * second / seconds)
        cv2.line(page, (x, top), (x, bottom), GRID, 1)
    _write(page, f"{MAX_FORCE:.0f} N", (24, top + 10), FORCE, 0.45)
    _write(page, "force", (24, bottom), FORCE, 0.45)
    _write(page, f"{1000 * MAX_WIDTH:.0f} mm", (right + 8, top + 10), FINGERS, 0.45)
    _write(page, "fingers", (right + 8, bottom), FINGERS, 0.45)
    if seconds:
        _write(page, f"{seconds:.1f} s", (right - 46, bottom + 18), FADED, 0.45)


def _place(page: Picture, picture: Picture, column: tuple[int, int]) -> None:
    left, width = column
    small = cv2.resize(picture, (width, SIDE), interpolation=cv2.INTER_AREA)
    page[TOP : TOP + SIDE, left : left + width] = small


def _with_lines(page: Picture, lines: list[Line]) -> Picture:
    written = page.copy()
    rows = [
        (label if part == 0 else "", piece)
        for label, text in lines
        for part, piece in enumerate(wrap(text, ROOM) or [""])
    ]
    for row, (label, text) in enumerate(rows[-LINES:]):
        foot = TEXT + LINE * row
        _write(written, label, (24, foot), FADED, 0.45)
        _write(written, text, (112, foot), OUTCOMES.get(text, INK), 0.45)
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
