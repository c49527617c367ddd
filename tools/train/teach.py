"""How a network learns from lessons: supervised, every answer being known."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import nn

from policies.learned import fastest_dtype
from tools.train.config import GraspCourse, GraspRound, PushCourse, PushRound
from tools.train.curve import Compared, CourseProgress, Curve, GraspValidation, PushValidation
from tools.train.run import STATE
from tools.train.whole import written_whole

BETAS = (0.9, 0.99)  # paper, section III-D
CLIP = 1.0  # of the gradient's norm
EPOCH = 200  # updates
WARM_UP = 100  # updates until the learning rate is reached
_CHUNK = 128  # questions at a time, where nothing is learnt

Array = npt.NDArray[np.float32]
Foretell: TypeAlias = Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, ...]]


class Lessons(Protocol):
    """Questions, and their answers (n,), 0 to 1."""

    @property
    def answer(self) -> Array: ...

    def __len__(self) -> int: ...

    def questions(
        self, picks: npt.NDArray[np.intp], rng: np.random.Generator | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Patches (k, C, h, w) and places (k, 2). rng: as another cell might show the same."""
        ...


SomeLessons = TypeVar("SomeLessons", bound=Lessons)


class Teacher:
    """Network and optimiser. Randomness comes from the generator that is passed in.

    foretell: patches and places -> logits (n,) of the answers, and values (n,) that are to be the
    answers, if there are any.
    """

    def __init__(self, network: nn.Module, foretell: Foretell, *, weight_decay: float) -> None:
        self.network = network
        self._foretell = foretell
        self._optimizer = torch.optim.AdamW(
            network.parameters(), betas=BETAS, weight_decay=weight_decay
        )

    def state(self) -> dict[str, Any]:
        return {"network": self.network.state_dict(), "optimizer": self._optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        self._optimizer.load_state_dict(state["optimizer"])

    def update(
        self, lessons: Lessons, rng: np.random.Generator, *, batch: int, learning_rate: float
    ) -> float:
        """One step on a random batch. Returns the loss: binary cross-entropy, and Huber's."""
        picks = rng.integers(len(lessons), size=batch)
        logits, *values = self._foretold(*lessons.questions(picks, rng))
        answer = torch.from_numpy(lessons.answer[picks])
        loss = F.binary_cross_entropy_with_logits(logits, answer)
        for value in values:
            loss = loss + F.huber_loss(value, answer)
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate
        self._optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), CLIP)
        self._optimizer.step()
        return loss.item()

    @torch.no_grad()
    def answers(self, lessons: Lessons) -> Array:
        """(n,) logits."""
        picks = np.array_split(np.arange(len(lessons)), max(1, len(lessons) // _CHUNK))
        logits = [self._foretold(*lessons.questions(some))[0] for some in picks]
        return torch.cat(logits).numpy()

    def _foretold(self, cuts: torch.Tensor, places: torch.Tensor) -> tuple[torch.Tensor, ...]:
        cuts = cuts.contiguous(memory_format=torch.channels_last)
        with torch.autocast("cpu", fastest_dtype(), enabled=fastest_dtype() != torch.float32):
            return tuple(each.float() for each in self._foretell(cuts, places))


@dataclass(frozen=True, kw_only=True)
class Teaching:
    """So many updates with batches of this size. directory: of curve and state."""

    directory: Path
    seed: int
    updates: int
    batch: int
    learning_rate: float

    def go_on(
        self,
        teacher: Teacher,
        lessons: Lessons,
        epochs: range,
        *,
        begins: int,
        validated: Callable[[], PushValidation | GraspValidation],
        on_epoch: Callable[[int], None],
    ) -> None:
        """Teach what is left of these updates, `epochs`, the first of which was `begins`. Each
        follows from seed, number and the state that is saved after the one before."""
        with Curve(self.directory, round=epochs.start) as curve:
            for epoch in epochs:
                rng = np.random.default_rng((self.seed, epoch))
                updates = range((epoch - begins) * EPOCH, (epoch - begins + 1) * EPOCH)
                losses = [
                    teacher.update(lessons, rng, batch=self.batch, learning_rate=self._rate(update))
                    for update in updates
                ]
                curve.add(
                    CourseProgress(
                        round=epoch + 1,
                        actions=(epoch + 1) * EPOCH,
                        learning_rate=self._rate(updates.stop),
                        loss=float(np.mean(losses)),
                        validation=validated(),
                    )
                )
                with written_whole(self.directory / STATE) as file:
                    torch.save({"teacher": teacher.state(), "epoch": epoch + 1}, file)
                on_epoch(epoch + 1)

    def _rate(self, update: int) -> float:
        """Rises over WARM_UP updates, then falls along a half cosine."""
        cosine = (1 + math.cos(math.pi * min(1.0, update / self.updates))) / 2
        return self.learning_rate * min(1.0, (update + 1) / WARM_UP) * max(cosine, 0.01)


@dataclass(frozen=True, kw_only=True)
class Tries(Generic[SomeLessons]):
    """What a course tries, and what is made of it. what: for who watches; total: of the whole
    course; size: of a record. play: the records of a round, of which so many are there already.
    lessons_of: a round's number and all records until then -> to learn from, and held out.
    judged: by what is held out and the logits that it is given."""

    what: str
    total: int
    size: int
    play: Callable[[int, int], Iterator[Path]]
    lessons_of: Callable[[int, Sequence[Path]], tuple[SomeLessons, SomeLessons]]
    judged: Callable[[SomeLessons, Array], PushValidation | GraspValidation]


def teach_in_rounds(
    course: PushCourse | GraspCourse,
    directory: Path,
    teacher: Teacher,
    tries: Tries[SomeLessons],
    on_progress: Callable[[str, int, int], None],
) -> None:
    """Each round is played, and learnt with those before; or what is left of it. on_progress: is
    told what is done, how much, and of how much."""
    epoch = restore(directory, teacher)
    played: list[Path] = []
    ends = 0  # epochs, at the end of a round
    rounds: Sequence[PushRound | GraspRound] = course.rounds
    for number, each in enumerate(rounds):
        for record in tries.play(number, len(played)):
            played.append(record)
            on_progress(tries.what, tries.size * len(played), tries.total)
        begins, ends = ends, ends + math.ceil(each.updates / EPOCH)
        if epoch < ends:
            teaching = Teaching(
                directory=directory,
                seed=course.seed,
                updates=each.updates,
                batch=course.batch,
                learning_rate=each.learning_rate,
            )
            lessons, held_out = tries.lessons_of(number, played)
            teaching.go_on(
                teacher,
                lessons,
                range(epoch, ends),
                begins=begins,
                validated=partial(_judged, tries, held_out, teacher),
                on_epoch=lambda done: on_progress("updates", done * EPOCH, course.updates),
            )
            epoch = ends


def _judged(
    tries: Tries[SomeLessons], held_out: SomeLessons, teacher: Teacher
) -> PushValidation | GraspValidation:
    return tries.judged(held_out, teacher.answers(held_out))


def restore(directory: Path, teacher: Teacher) -> int:
    """Epochs that are done."""
    file = directory / STATE
    if not file.exists():
        return 0
    state = torch.load(file, weights_only=True)
    teacher.restore(state["teacher"])
    return int(state["epoch"])


def cross_entropy(lessons: Lessons, logits: Array) -> float:
    return float((np.logaddexp(0, logits) - lessons.answer * logits).mean())


def compared(questions: npt.NDArray[np.intp], answer: Array, logits: Array) -> Compared | None:
    """Means over what was asked of several actions; None where nothing was. questions: (n, k)
    numbers that tell one from another."""
    which, question = np.unique(questions, axis=0, return_inverse=True)
    rows = [
        (answer[of_it][logits[of_it].argmax()], answer[of_it].mean(), answer[of_it].max())
        for of_it in (question == number for number in range(len(which)))
        if of_it.sum() > 1
    ]
    if not rows:
        return None
    chosen, every, best = np.mean(rows, axis=0)
    return Compared(chosen=float(chosen), any=float(every), best=float(best))
