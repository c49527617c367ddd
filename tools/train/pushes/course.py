"""A PushNet of its own for a policy: pushes are played and kept, then it is taught by them.

Records follow from seed and number alone, and each epoch from seed, number and the state saved
after the one before, so a course that was killed goes on as if it had not been.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from policies.checkpoint import Checkpoint, PolicyConfig, load_checkpoint, save_checkpoint
from policies.networks.twin import PushNet, TwinNet
from tdpg_deploy.episode_log import software
from tdpg_deploy.errors import ConfigError
from tools.pool import process_pool
from tools.train.claim import claim
from tools.train.config import PushCourse
from tools.train.curve import Curve, Freed, PushProgress, PushValidation, read_curve
from tools.train.pushes.lessons import ALL, Lessons, lessons_of
from tools.train.pushes.play import PushRecord, PushTask, play_pushes
from tools.train.pushes.teach import Teacher
from tools.train.run import STATE, WEIGHTS, started_with
from tools.train.trainer import training_cell

Logits = npt.NDArray[np.float32]

RECORD = 200  # pushes in one file
HELD_OUT = 10  # every so many-th record is for validation
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

    Raises ConfigError when the directory belongs to another course, or the policy to begin with
    has no light network.
    """
    if course.start is None:
        raise ConfigError("a course of pushes is for a policy that grasps: give --from FILE")
    start = load_checkpoint(course.start)
    network = _beside(course.start, start)
    claim(directory, course.model_dump(mode="json", exclude={"start", "workers"}))
    played = []
    for record in _play(course, directory):
        played.append(record)
        on_progress("pushes played", RECORD * len(played), course.pushes)
    _teach(course, directory, network.push_net, played, on_progress)
    return _freeze(course, directory, out, network, start)


def _teach(
    course: PushCourse,
    directory: Path,
    network: PushNet,
    played: Sequence[Path],
    on_progress: Callable[[str, int, int], None],
) -> None:
    teacher = Teacher(network, weight_decay=course.weight_decay)
    epoch = _restore(directory, teacher)
    if epoch * EPOCH >= course.updates:
        return
    lessons, held_out = _split([PushRecord.load(path) for path in played])
    with Curve(directory, round=epoch) as curve:
        while epoch * EPOCH < course.updates:
            rng = np.random.default_rng((course.seed, epoch))
            updates = range(epoch * EPOCH, (epoch + 1) * EPOCH)
            losses = [
                teacher.update(
                    lessons, rng, batch=course.batch, learning_rate=_learning_rate(course, update)
                )
                for update in updates
            ]
            epoch += 1
            curve.add(
                PushProgress(
                    round=epoch,
                    actions=updates.stop,
                    learning_rate=_learning_rate(course, updates.stop),
                    loss=float(np.mean(losses)),
                    validation=judged(held_out, teacher),
                )
            )
            _save(directory, teacher, epoch)
            on_progress("updates", updates.stop, course.updates)


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


def _play(course: PushCourse, records: Path) -> Iterator[Path]:
    cell = training_cell()
    tasks = [
        PushTask(
            cell=cell,
            randomization=course.randomization,
            seed=(course.seed, number),
            pushes=RECORD,
            file=records / f"{number:04d}.npz",
        )
        for number in range(math.ceil(course.pushes / RECORD))
    ]
    with process_pool(course.workers) as pool:
        yield from pool.map(play_pushes, tasks)


def _split(records: list[PushRecord]) -> tuple[Lessons, Lessons]:
    """To learn from, and held out."""
    out = records[HELD_OUT - 1 :: HELD_OUT]
    kept = [record for i, record in enumerate(records) if i % HELD_OUT != HELD_OUT - 1]
    return lessons_of(kept), lessons_of(out)


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


def _learning_rate(course: PushCourse, update: int) -> float:
    """Rises over WARM_UP updates, then falls along a half cosine."""
    cosine = (1 + math.cos(math.pi * update / course.updates)) / 2
    return course.learning_rate * min(1.0, (update + 1) / WARM_UP) * max(cosine, 0.01)


def _restore(directory: Path, teacher: Teacher) -> int:
    """Epochs that are done."""
    file = directory / STATE
    if not file.exists():
        return 0
    state = torch.load(file, weights_only=True)
    teacher.restore(state["teacher"])
    return int(state["epoch"])


def _save(directory: Path, teacher: Teacher, epoch: int) -> None:
    part = directory / (STATE + ".part")
    torch.save({"teacher": teacher.state(), "epoch": epoch}, part)
    os.replace(part, directory / STATE)


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
