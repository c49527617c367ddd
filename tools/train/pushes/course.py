"""A PushNet of its own for a policy: pushes are played and kept, then it is taught by them.

Records follow from seed and number alone, and each epoch from seed, number and the state saved
after the one before, so a course that was killed goes on as if it had not been.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from policies.checkpoint import Checkpoint, PolicyConfig, load_checkpoint, save_checkpoint
from policies.networks.twin import TwinNet
from tdpg_deploy.episode_log import software
from tdpg_deploy.errors import ConfigError
from tools.pool import process_pool
from tools.train.claim import claim
from tools.train.config import PushCourse, PushRound
from tools.train.curve import Curve, Freed, PushProgress, PushValidation, read_curve
from tools.train.hold_out import split
from tools.train.pushes.lessons import ALL, Lessons, lessons_of
from tools.train.pushes.play import PushRecord, PushTask, play_pushes
from tools.train.pushes.teach import Teacher
from tools.train.run import STATE, WEIGHTS, started_with
from tools.train.trainer import training_cell
from tools.train.whole import written_whole

Logits = npt.NDArray[np.float32]

RECORD = 200  # pushes in one file
EPOCH = 200  # updates
WARM_UP = 100  # updates until the learning rate is reached


def teach_pushes(
    course: PushCourse,
    out: Path,
    directory: Path,
    *,
    on_progress: Callable[[str, int, int], None],
) -> Path:
    """Play and teach, or go on with what `directory` holds. Returns the policy's file in `out`:
    `course.start` with this PushNet. on_progress: is told what is done, how much, and of how much.

    Raises ConfigError when the directory belongs to another course, the policy to begin with has
    no light network, or the first round is of one record.
    """
    if course.start is None:
        raise ConfigError("a course of pushes is for a policy that grasps: give --from FILE")
    first = math.ceil(course.rounds[0].pushes / RECORD)
    split(range(first), RECORD)  # too few: said before anything is played
    start = load_checkpoint(course.start)
    network = _beside(course.start, start)
    claim(directory, course.model_dump(mode="json", exclude={"start", "workers"}))
    teacher = Teacher(network.push_net, weight_decay=course.weight_decay)
    epoch = _restore(directory, teacher)
    played: list[Path] = []
    ends = 0  # epochs, at the end of a round
    for number, each in enumerate(course.rounds):
        chooser = directory / f"push_net-{number}.pt" if number else None
        if chooser is not None and not chooser.exists():
            with written_whole(chooser) as file:
                torch.save(teacher.network.state_dict(), file)
        for record in _play(course, each, len(played), chooser, directory):
            played.append(record)
            on_progress("pushes played", RECORD * len(played), course.pushes)
        begins, ends = ends, ends + math.ceil(each.updates / EPOCH)
        if epoch < ends:
            _teach(course, each, range(epoch, ends), begins, teacher, played, on_progress)
            epoch = ends
    return _freeze(course, directory, out, network, start)


def _teach(
    course: PushCourse,
    each: PushRound,
    epochs: range,
    begins: int,
    teacher: Teacher,
    played: Sequence[Path],
    on_progress: Callable[[str, int, int], None],
) -> None:
    """What is left of a round, whose first epoch is `begins`."""
    directory = played[0].parent
    lessons, held_out = map(lessons_of, split([PushRecord.load(path) for path in played], RECORD))
    with Curve(directory, round=epochs.start) as curve:
        for epoch in epochs:
            rng = np.random.default_rng((course.seed, epoch))
            updates = range((epoch - begins) * EPOCH, (epoch - begins + 1) * EPOCH)
            losses = [
                teacher.update(
                    lessons, rng, batch=course.batch, learning_rate=_learning_rate(each, update)
                )
                for update in updates
            ]
            done = (epoch + 1) * EPOCH
            curve.add(
                PushProgress(
                    round=epoch + 1,
                    actions=done,
                    learning_rate=_learning_rate(each, updates.stop),
                    loss=float(np.mean(losses)),
                    validation=judged(held_out, teacher),
                )
            )
            _save(directory, teacher, epoch + 1)
            on_progress("updates", done, course.updates)


def judged(held_out: Lessons, teacher: Teacher) -> PushValidation:
    """By pushes of tables that nothing is learnt from."""
    logits = teacher.answers(held_out)
    loss = np.logaddexp(0, logits) - held_out.freed * logits
    return PushValidation(
        loss=float(loss.mean()),
        goal=_freed(held_out, logits, held_out.goal != ALL),
        all=_freed(held_out, logits, held_out.goal == ALL),
    )


def _freed(lessons: Lessons, logits: Logits, which: npt.NDArray[np.bool_]) -> Freed | None:
    """Means over what was asked of several pushes from one look; None where nothing was."""
    asked = np.stack([lessons.look, lessons.goal.astype(np.intp)])[:, which]
    questions, question = np.unique(asked, axis=1, return_inverse=True)
    freed, logits = lessons.freed[which], logits[which]
    rows = [
        (freed[of_it][logits[of_it].argmax()], freed[of_it].mean(), freed[of_it].max())
        for of_it in (question == number for number in range(questions.shape[1]))
        if of_it.sum() > 1
    ]
    if not rows:
        return None
    chosen, every, best = np.mean(rows, axis=0)
    return Freed(chosen=float(chosen), any=float(every), best=float(best))


def _play(
    course: PushCourse, each: PushRound, first: int, chooser: Path | None, directory: Path
) -> Iterator[Path]:
    """The records of a round, of which so many are there already."""
    cell = training_cell()
    tasks = [
        PushTask(
            cell=cell,
            randomization=course.randomization,
            seed=(course.seed, number),
            pushes=RECORD,
            file=directory / f"{number:04d}.npz",
            chooser=chooser,
            compact=each.compact,
            knots=each.knots,
        )
        for number in range(first, first + math.ceil(each.pushes / RECORD))
    ]
    with process_pool(course.workers) as pool:
        yield from pool.map(play_pushes, tasks)


def _beside(path: Path, start: Checkpoint) -> TwinNet:
    """A fresh PushNet beside the policy's light network. Raises ConfigError."""
    config = start.config
    torch.manual_seed(0)
    network = TwinNet(goal=config.goal, width=config.width)
    if config.network == "light":
        network.light.load_state_dict(start.weights)
    elif config.network == "twin":
        network.light.load_state_dict(
            {
                name.removeprefix("light."): weight
                for name, weight in start.weights.items()
                if name.startswith("light.")
            }
        )
    else:
        raise ConfigError(f"{path}: network is {config.network}: begin with a light or a twin one")
    return network


def _learning_rate(each: PushRound, update: int) -> float:
    """Rises over WARM_UP updates of a round, then falls along a half cosine."""
    cosine = (1 + math.cos(math.pi * min(1.0, update / each.updates))) / 2
    return each.learning_rate * min(1.0, (update + 1) / WARM_UP) * max(cosine, 0.01)


def _restore(directory: Path, teacher: Teacher) -> int:
    """Epochs that are done."""
    file = directory / STATE
    if not file.exists():
        return 0
    state = torch.load(file, weights_only=True)
    teacher.restore(state["teacher"])
    return int(state["epoch"])


def _save(directory: Path, teacher: Teacher, epoch: int) -> None:
    with written_whole(directory / STATE) as file:
        torch.save({"teacher": teacher.state(), "epoch": epoch}, file)


def _freeze(
    course: PushCourse, directory: Path, out: Path, network: TwinNet, start: Checkpoint
) -> Path:
    provenance: dict[str, Any] = {
        "experiment": course.model_dump(mode="json", exclude={"start"}),
        "start": started_with(start),
        "actions": course.pushes,
        "updates": course.updates,
        "commit": software.commit(),
        "validation": read_curve(directory)[-1]["validation"],
    }
    out.mkdir(parents=True, exist_ok=True)
    path = out / WEIGHTS
    config = PolicyConfig(
        network="twin",
        width=start.config.width,
        goal=start.config.goal,
        method=start.config.method,
    )
    save_checkpoint(path, network, config, provenance)
    return path
