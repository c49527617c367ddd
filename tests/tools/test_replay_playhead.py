"""Live replay by a clock that the test turns."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.replay.playhead import Playhead, play

SECOND = 1_000_000_000


@dataclass(frozen=True)
class Note:
    log_time: int
    topic: str = "/a"


class Wall:
    """A machine's clock that grows when somebody sleeps."""

    def __init__(self) -> None:
        self.time = 100.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


@given(speed=st.floats(0.1, 50), seconds=st.floats(0, 1000))
def test_the_playhead_moves_with_its_speed(speed: float, seconds: float) -> None:
    wall = Wall()
    playhead = Playhead(7 * SECOND, speed=speed, now=wall.now)
    wall.sleep(seconds)
    assert playhead.time == pytest.approx(7 * SECOND + speed * seconds * SECOND, abs=1000)


def test_a_paused_playhead_stands_still_and_goes_on_from_there() -> None:
    wall = Wall()
    playhead = Playhead(0, speed=2.0, now=wall.now)
    wall.sleep(3)
    playhead.control(play=False, speed=2.0, seek=None)
    wall.sleep(100)
    assert playhead.time == 6 * SECOND
    playhead.control(play=True, speed=1.0, seek=None)
    wall.sleep(1)
    assert playhead.time == 7 * SECOND
    assert playhead.jumps == 0


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_speed_that_is_none_changes_nothing(speed: float) -> None:
    wall = Wall()
    playhead = Playhead(0, speed=2.0, now=wall.now)
    playhead.control(play=True, speed=speed, seek=SECOND)
    wall.sleep(1)
    assert playhead.time == 3 * SECOND


def test_nothing_is_left_out_by_who_begins_late() -> None:
    wall, heard = Wall(), []
    playhead = Playhead(0, speed=1.0, now=wall.now)
    playhead.control(play=True, speed=1.0, seek=2 * SECOND)
    wall.sleep(3)
    notes = [Note(second * SECOND) for second in range(1, 6)]
    assert play(notes, lambda note: heard.append(note.log_time // SECOND), playhead, wall.sleep)
    assert heard == [1, 2, 3, 4, 5]  # the first, as the last one from before


def test_messages_come_at_their_time() -> None:
    wall, heard = Wall(), []
    playhead = Playhead(0, speed=2.0, now=wall.now)
    notes = [Note(0), Note(2 * SECOND), Note(10 * SECOND)]
    assert play(notes, lambda note: heard.append((note.log_time, wall.time)), playhead, wall.sleep)
    for log_time, at in heard:
        assert at == pytest.approx(100 + log_time / SECOND / 2, abs=0.03)
    assert len(heard) == 3


def test_after_a_jump_the_last_of_each_topic_comes_first() -> None:
    wall, heard = Wall(), list[Note]()
    playhead = Playhead(0, speed=1.0, now=wall.now)
    notes = [Note(0), Note(SECOND), Note(SECOND, "/b"), Note(5 * SECOND), Note(9 * SECOND, "/b")]

    def hear(note: Note) -> None:
        heard.append(note)
        if len(heard) == 1:
            playhead.control(play=True, speed=1.0, seek=4 * SECOND)

    assert not play(notes, hear, playhead, wall.sleep)
    heard.clear()
    assert play(notes, heard.append, playhead, wall.sleep)
    assert heard == notes[1:]


def test_a_place_behind_the_end_shows_the_last_state() -> None:
    wall, heard = Wall(), list[Note]()
    playhead = Playhead(99 * SECOND, speed=1.0, now=wall.now)
    assert play([Note(0), Note(SECOND)], heard.append, playhead, wall.sleep)
    assert heard == [Note(SECOND)]
