"""The curve on disk, and what TensorBoard would read of it."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from tensorboardX.proto.event_pb2 import Event

from tools.train.curve import EVENTS, Curve, Progress, Validation, read_curve


def line(round: int) -> Progress:
    return Progress(
        round=round,
        stage="grasp",
        actions=48 * round,
        updates=0,
        epsilon=0.5,
        learning_rate=1e-4,
        grasp_success=0.25,
        push_reward=None,
        huber=None,
        bce=None,
        td_error=None,
        validation=Validation(completion=1.0, grasp_success=0.75, efficiency=0.5, motions=20.0)
        if round == 2
        else None,
    )


def events(directory: Path) -> Iterator[Event]:
    """Of all event files: records of length (8 bytes), CRC (4), content, CRC (4)."""
    for file in sorted((directory / EVENTS).iterdir()):
        content = file.read_bytes()
        while content:
            (length,) = struct.unpack_from("<Q", content)
            event = Event()
            event.ParseFromString(content[12 : 12 + length])
            yield event
            content = content[16 + length :]


def test_a_round_is_a_line_and_events(tmp_path: Path) -> None:
    with Curve(tmp_path, round=0) as curve:
        curve.add(line(1))
        curve.add(line(2))
    assert read_curve(tmp_path) == [dataclasses.asdict(line(n)) for n in (1, 2)]
    told = {
        (event.step, value.tag): value.simple_value
        for event in events(tmp_path)
        for value in event.summary.value
    }
    assert told[48, "train/grasp_success"] == told[96, "train/grasp_success"] == 0.25
    assert told[96, "validation/grasp_success"] == 0.75
    assert (48, "train/push_reward") not in told
    assert told[48, "train/epsilon"] == pytest.approx(0.5)


def test_what_was_not_saved_before_a_kill_is_dropped(tmp_path: Path) -> None:
    with Curve(tmp_path, round=0) as curve:
        curve.add(line(1))
        curve.add(line(2))
    with Curve(tmp_path, round=1) as curve:
        curve.add(line(2))
    assert [read["round"] for read in read_curve(tmp_path)] == [1, 2]
    restarts = [
        event.step
        for event in events(tmp_path)
        if event.session_log.status == event.session_log.START
    ]
    assert 49 in restarts  # TensorBoard forgets steps from here on
