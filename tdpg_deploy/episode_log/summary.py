"""One picture that explains an episode: a card for each step, under the figures of the whole."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from policies.primitives import Push
from tdpg_deploy.episode_log.entries import Intent, Step
from tdpg_deploy.episode_log.pictures import draw_action, draw_goal, enlarge
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import LogError
from tdpg_deploy.outcome import GraspOutcome, Outcome, Verdict

Picture = npt.NDArray[np.uint8]
Color = tuple[int, int, int]

MAX_CARDS = 60
COLUMNS = 3
MARGIN = 24
THUMBNAIL = 280
GAP = 10
TITLE = 44
FOOTER = 86
CARD_WIDTH = 2 * THUMBNAIL + 3 * GAP
CARD_HEIGHT = TITLE + THUMBNAIL + FOOTER
HEADER = 118

PAPER: Color = (244, 243, 240)
CARD: Color = (255, 255, 255)
EDGE: Color = (214, 212, 206)
INK: Color = (32, 34, 38)
FADED: Color = (110, 112, 118)
VERDICTS: dict[Verdict, Color] = {
    Verdict.YES: (38, 150, 84),
    Verdict.NO: (204, 60, 52),
    Verdict.UNKNOWN: (200, 140, 20),
}
WORDS = {Verdict.YES: "success", Verdict.NO: "failed", Verdict.UNKNOWN: "unknown"}


def write_summary(log: Path, picture: Path) -> None:
    """Draw the episode in `log` into the PNG file `picture`. Raises LogError."""
    rgb = draw_summary(read_episode(log))
    done, png = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))
    assert done
    try:
        picture.write_bytes(png.tobytes())
    except OSError as error:
        raise LogError(f"{picture}: cannot be written ({error.strerror})") from error


def draw_summary(episode: Episode) -> Picture:
    """(H, W, 3) uint8 RGB. Of a damaged log it shows what can be read, and says so."""
    cards: list[Picture] = []
    left_out, damage = 0, None
    try:
        for number, step in enumerate(episode.steps(states=False), start=1):
            if len(cards) < MAX_CARDS:
                cards.append(_card(number, step))
            else:
                left_out += 1
    except LogError as error:
        damage = str(error)
    columns = min(COLUMNS, max(len(cards), 2))
    rows = -(-len(cards) // columns)
    height = HEADER + rows * (CARD_HEIGHT + GAP) + MARGIN
    width = 2 * MARGIN + columns * (CARD_WIDTH + GAP) - GAP
    sheet = np.full((height, width, 3), PAPER, np.uint8)
    for line, (text, size, color) in enumerate(_header(episode, left_out, damage)):
        _write(sheet, text, (MARGIN, 42 + 30 * line), color, size)
    for i, card in enumerate(cards):
        top = HEADER + i // columns * (CARD_HEIGHT + GAP)
        left = MARGIN + i % columns * (CARD_WIDTH + GAP)
        sheet[top : top + CARD_HEIGHT, left : left + CARD_WIDTH] = card
    return sheet


# --- words ------------------------------------------------------------------------------------


def _header(
    episode: Episode, left_out: int, damage: str | None
) -> Iterator[tuple[str, float, Color]]:
    about, result = episode.about, episode.result()
    seed = "" if about.seed is None else f", seed {about.seed}"
    yield f"{about.cell.name} cell, policy {about.policy}{seed}", 0.85, INK
    if result is None:
        yield "the log ends before the episode did", 0.6, VERDICTS[Verdict.NO]
    else:
        yield _figures(result), 0.6, INK
    if damage is not None:
        yield f"damaged: {damage}", 0.5, VERDICTS[Verdict.NO]
    elif left_out:
        yield f"{left_out} further steps are in the log", 0.5, FADED
    else:
        yield episode.path.name, 0.5, FADED


def _figures(result: EpisodeResult) -> str:
    parts = [
        f"ended: {result.reason.value}",
        f"actions {result.actions}",
        f"time {result.seconds:.0f} s",
        f"grasps {result.grasp_successes}/{result.grasps}",
        f"pushes {result.push_successes}/{result.pushes}",
        f"delivered {result.delivered}",
    ]
    if result.refused:
        parts.append(f"refused {result.refused}")
    return "   ".join(parts)


def _witnesses(outcome: Outcome) -> str:
    if isinstance(outcome, GraspOutcome):
        width = outcome.width_after_lift
        text = f"held {outcome.held_by_width.value}, gone {outcome.gone_from_map.value}"
        text += f", {round(1000 * width)} mm wide" if isfinite(width) else ""
    else:
        text = f"travelled {round(1000 * outcome.travelled)} mm, changed {outcome.changed.value}"
    contact = outcome.motion.contact
    return text if contact is None else f"{text}, force stop at {contact}"


def _reasoning(intent: Intent) -> str:
    parts = list(intent.plan.notes)
    verdict = intent.decision.verdict
    if verdict is not None:
        said = "overruled" if verdict.overruled else "agreed"
        parts.append(f"critic II {said}")
    if intent.decision.p_foreseen is not None:
        parts.append(f"foreseen to work: {intent.decision.p_foreseen:.0%}")
    return ", ".join(parts)


def _remarks(step: Step) -> Iterator[tuple[str, Color]]:
    """The lines under a card's pictures."""
    if step.outcome is not None:
        yield _witnesses(step.outcome), INK
    reasoning = "" if step.intent is None else _reasoning(step.intent)
    if reasoning:
        yield reasoning, FADED
    if step.refusals:
        yield f"{len(step.refusals)} refused: {step.refusals[-1].reason}", FADED


# --- cards ------------------------------------------------------------------------------------


def _card(number: int, step: Step) -> Picture:
    card = np.full((CARD_HEIGHT, CARD_WIDTH, 3), CARD, np.uint8)
    verdict = Verdict.UNKNOWN if step.outcome is None else step.outcome.success
    color = VERDICTS[verdict]
    card[:4] = color
    _write(card, f"{number}  {_title(step.intent)}", (GAP, 30), INK, 0.6)
    word = "no outcome" if step.outcome is None else WORDS[verdict]
    _write(card, word, (CARD_WIDTH - GAP - _width(word, 0.6), 30), color, 0.6)
    for picture, left in ((_seen(step), GAP), (_values(step), 2 * GAP + THUMBNAIL)):
        small = cv2.resize(picture, (THUMBNAIL, THUMBNAIL), interpolation=cv2.INTER_AREA)
        card[TITLE : TITLE + THUMBNAIL, left : left + THUMBNAIL] = small
    for line, (text, ink) in enumerate(_remarks(step)):
        _write(card, _fit(text, 0.48), (GAP, TITLE + THUMBNAIL + 26 + 22 * line), ink, 0.48)
    cv2.rectangle(card, (0, 4), (CARD_WIDTH - 1, CARD_HEIGHT - 1), EDGE)
    return card


def _title(intent: Intent | None) -> str:
    if intent is None:
        return "every action refused"
    decision = intent.decision
    kind = "push" if isinstance(decision.primitive, Push) else "grasp"
    return f"{kind}  q {decision.q:.2f}  rotation {decision.rotation}"


def _seen(step: Step) -> Picture:
    if step.look is None:
        return np.full((THUMBNAIL, THUMBNAIL, 3), EDGE, np.uint8)
    heightmap = step.look.heightmap
    picture = enlarge(heightmap.color)
    if heightmap.goal is not None:
        draw_goal(picture, heightmap.goal)
    if step.intent is not None:
        draw_action(picture, step.intent.decision.primitive, heightmap.workspace)
    return picture


def _values(step: Step) -> Picture:
    if step.q_pictures is None or step.intent is None:
        return np.full((THUMBNAIL, THUMBNAIL, 3), EDGE, np.uint8)
    is_push = isinstance(step.intent.decision.primitive, Push)
    return step.q_pictures.push if is_push else step.q_pictures.grasp


# --- text -------------------------------------------------------------------------------------

_FONT = cv2.FONT_HERSHEY_DUPLEX


def _write(picture: Picture, text: str, at: tuple[int, int], color: Color, size: float) -> None:
    cv2.putText(picture, text, at, _FONT, size, color, 1, cv2.LINE_AA)


def _width(text: str, size: float) -> int:
    return int(cv2.getTextSize(text, _FONT, size, 1)[0][0])


def _fit(text: str, size: float) -> str:
    """Shortened until it fits into a card."""
    room = CARD_WIDTH - 2 * GAP
    if _width(text, size) <= room:
        return text
    while text and _width(f"{text}...", size) > room:
        text = text[:-1]
    return f"{text}..."
