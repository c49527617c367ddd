from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import nn

from tools.train import teach
from tools.train.curve import GraspValidation, read_curve
from tools.train.teach import Array, Teacher, Teaching, compared, cross_entropy, restore


@dataclass(frozen=True)
class LeftOrRight:
    """The answer is 1 where the first pixel is brighter than the last."""

    pictures: Array

    @property
    def answer(self) -> Array:
        return (self.pictures[:, 0, 0, 0] > self.pictures[:, 0, 0, -1]).astype(np.float32)

    def __len__(self) -> int:
        return len(self.pictures)

    def questions(
        self, picks: npt.NDArray[np.intp], rng: np.random.Generator | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.from_numpy(self.pictures[picks]), torch.zeros(len(picks), 2)


@pytest.fixture
def lessons() -> LeftOrRight:
    return LeftOrRight(np.random.default_rng(0).random((64, 1, 1, 4)).astype(np.float32))


def teacher() -> Teacher:
    torch.manual_seed(0)
    network = nn.Sequential(nn.Flatten(), nn.Linear(4, 2))

    def foretell(cuts: torch.Tensor, _places: torch.Tensor) -> tuple[torch.Tensor, ...]:
        logit, value = network(cuts).unbind(1)
        return logit, value

    return Teacher(network, foretell, weight_decay=0.0)


def teaching(directory: Path) -> Teaching:
    return Teaching(directory=directory, seed=1, updates=30, batch=32, learning_rate=0.5)


def go_on(
    directory: Path,
    taught: Teacher,
    lessons: LeftOrRight,
    epochs: range,
    on_epoch: Callable[[int], None] = lambda epoch: None,
) -> None:
    def validated() -> GraspValidation:
        return GraspValidation(loss=cross_entropy(lessons, taught.answers(lessons)), held=None)

    teaching(directory).go_on(
        taught, lessons, epochs, begins=0, validated=validated, on_epoch=on_epoch
    )


def test_it_learns_what_can_be_known(
    monkeypatch: pytest.MonkeyPatch, lessons: LeftOrRight, tmp_path: Path
) -> None:
    """And what was killed after an epoch goes on to the same weights and the same curve."""
    monkeypatch.setattr(teach, "EPOCH", 10)
    monkeypatch.setattr(teach, "WARM_UP", 1)
    straight, broken = tmp_path / "straight", tmp_path / "broken"
    straight.mkdir()
    broken.mkdir()
    taught = teacher()
    go_on(straight, taught, lessons, range(3))
    right = (taught.answers(lessons) > 0) == lessons.answer.astype(np.bool_)
    assert right.mean() > 0.9

    def killed(_epoch: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        go_on(broken, teacher(), lessons, range(3), killed)
    again = teacher()
    assert restore(broken, again) == 1
    go_on(broken, again, lessons, range(1, 3))
    for ours, theirs in zip(taught.network.parameters(), again.network.parameters(), strict=True):
        assert torch.equal(ours, theirs)
    assert read_curve(broken) == read_curve(straight)
    assert restore(tmp_path, again) == 0


def test_the_rate_rises_and_then_falls_along_a_cosine(
    monkeypatch: pytest.MonkeyPatch, lessons: LeftOrRight, tmp_path: Path
) -> None:
    monkeypatch.setattr(teach, "EPOCH", 15)
    monkeypatch.setattr(teach, "WARM_UP", 10)
    go_on(tmp_path, teacher(), lessons, range(2))
    halfway, end = (line["learning_rate"] for line in read_curve(tmp_path))
    assert halfway == pytest.approx(0.25)
    assert end == pytest.approx(0.005)


def test_of_each_question_the_likeliest_the_mean_and_the_best_are_compared() -> None:
    questions = np.array([[0, 1], [0, 1], [0, 2], [0, 2], [0, 2], [1, 1]])
    answer = np.array([1, 0, 0, 1, 1, 1], np.float32)
    logits = np.array([2, 1, 3, 2, 1, 9], np.float32)
    comparison = compared(questions, answer, logits)
    assert comparison is not None  # the last question was asked of one action only
    assert comparison.chosen == pytest.approx((1 + 0) / 2)
    assert comparison.any == pytest.approx((1 / 2 + 2 / 3) / 2)
    assert comparison.best == 1
    assert compared(questions[-1:], answer[-1:], logits[-1:]) is None
