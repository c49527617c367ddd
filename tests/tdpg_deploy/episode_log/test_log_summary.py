"""The summary of an episode: one card a step, also when there are none, many, or damage."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from synthetic_episode import Call, Synthetic, small_disk, write

from tdpg_deploy.episode_log import summary
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.errors import LogError
from tdpg_deploy.outcome import Verdict


@pytest.fixture(scope="module")
def calls() -> list[Call]:
    return Synthetic().episode(4)


def logged(path: Path, calls: list[Call]) -> Episode:
    write(path, calls, now=Synthetic().now)
    return read_episode(path)


def stripes(picture: npt.NDArray[np.uint8], verdict: Verdict) -> int:
    """How many cards carry this verdict's colour along their upper edge."""
    color = (picture == summary.VERDICTS[verdict]).all(axis=-1)
    starts = color.sum(axis=1) >= summary.CARD_WIDTH
    rows = np.nonzero(starts & ~np.roll(starts, 1))[0]
    return int(sum(round(color[row].sum() / summary.CARD_WIDTH) for row in rows))


def test_one_card_a_step(tmp_path: Path, calls: list[Call]) -> None:
    picture = summary.draw_summary(logged(tmp_path / "e.mcap", calls))
    assert picture.dtype == np.uint8
    found = [stripes(picture, verdict) for verdict in Verdict]
    assert found == [2, 1, 1]


def test_saved_as_png(tmp_path: Path, calls: list[Call]) -> None:
    episode = logged(tmp_path / "e.mcap", calls)
    summary.write_summary(episode.path, tmp_path / "e.png")
    bgr = cv2.imread(str(tmp_path / "e.png"))
    assert bgr is not None
    assert np.array_equal(bgr[..., ::-1], summary.draw_summary(episode))


def test_an_episode_without_steps(tmp_path: Path, calls: list[Call]) -> None:
    picture = summary.draw_summary(logged(tmp_path / "e.mcap", [calls[0], calls[-1]]))
    assert stripes(picture, Verdict.YES) == 0
    assert len(picture) < 200


def test_a_damaged_log_shows_what_is_left(tmp_path: Path, calls: list[Call]) -> None:
    path = tmp_path / "e.mcap"
    write(path, calls, now=Synthetic().now)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    picture = summary.draw_summary(read_episode(path))
    assert 1 <= sum(stripes(picture, verdict) for verdict in Verdict) < 4


def test_long_episodes_end_in_a_count(
    tmp_path: Path, calls: list[Call], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(summary, "MAX_CARDS", 2)
    picture = summary.draw_summary(logged(tmp_path / "e.mcap", calls))
    assert sum(stripes(picture, verdict) for verdict in Verdict) == 2


def test_a_full_disk(tmp_path: Path, calls: list[Call]) -> None:
    episode = logged(tmp_path / "e.mcap", calls)
    with pytest.raises(LogError, match=r"e\.png: cannot be written"), small_disk(1000):
        summary.write_summary(episode.path, tmp_path / "e.png")
