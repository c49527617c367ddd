"""A PushNet of its own for a policy: pushes are played and kept, then it is taught by them.

Records follow from seed and number alone, and each epoch from seed, number and the state saved
after the one before, so a course that was killed goes on as if it had not been.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import accumulate
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from policies.checkpoint import Checkpoint, PolicyConfig, load_checkpoint, save_checkpoint
from policies.networks.twin import TwinNet
from tdpg_deploy.errors import ConfigError
from tools.pool import process_pool
from tools.train.claim import claim
from tools.train.config import PushCourse, PushRound
from tools.train.curve import Compared, PushValidation, read_curve
from tools.train.hold_out import split
from tools.train.pushes.lessons import ALL, Lessons, lessons_of
from tools.train.pushes.play import PushRecord, PushTask, play_pushes
from tools.train.run import WEIGHTS, provenance_of
from tools.train.teach import Array, Teacher, Tries, compared, cross_entropy, teach_in_rounds
from tools.train.trainer import training_cell
from tools.train.whole import written_whole

RECORD = 200  # pushes in one file


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
    no light network that knows no goal, or the first round is of one record.
    """
    if course.start is None:
        raise ConfigError("a course of pushes is for a policy that grasps: give --from FILE")
    for number in range(len(course.rounds)):
        _split(course, number)  # too few: said before anything is played
    start = load_checkpoint(course.start)
    network = _beside(course.start, start)
    claim(directory, course.model_dump(mode="json", exclude={"start", "workers"}))
    teacher = Teacher(
        network.push_net,
        lambda cuts, places: (network.push_net.at(cuts, places),),
        weight_decay=course.weight_decay,
    )

    def play(number: int, first: int) -> Iterator[Path]:
        chooser = directory / f"push_net-{number}.pt" if number else None
        if chooser is not None and not chooser.exists():
            with written_whole(chooser) as file:
                torch.save(teacher.network.state_dict(), file)
        return _play(course, course.rounds[number], first, chooser, directory)

    tries = Tries(
        what="pushes played",
        total=course.pushes,
        size=RECORD,
        play=play,
        lessons_of=partial(_lessons_of, course),
        judged=judged,
    )
    teach_in_rounds(course, directory, teacher, tries, on_progress)
    return _freeze(course, directory, out, network, start)


def _lessons_of(course: PushCourse, number: int, played: Sequence[Path]) -> tuple[Lessons, Lessons]:
    """To learn from in this round, and held out."""
    kept, out = _split(course, number)
    return (
        lessons_of([PushRecord.load(played[record]) for record in kept]),
        lessons_of([PushRecord.load(played[record]) for record in out]),
    )


def _split(course: PushCourse, number: int) -> tuple[list[int], list[int]]:
    """Which records this round learns from, and which are held out. Raises ConfigError where there
    are none of either."""
    ends = [0, *accumulate(map(_records, course.rounds))]
    first = ends[course.rounds[number].since]
    kept, out = split(range(ends[number + 1]), RECORD)
    kept, out = [each for each in kept if each >= first], [each for each in out if each >= first]
    if not (kept and out):
        raise ConfigError(
            f"round {number} learns from records {first} to {ends[number + 1] - 1} of {RECORD} "
            "pushes: too few to learn from some and be judged by others, give a smaller since"
        )
    return kept, out


def _records(each: PushRound) -> int:
    return math.ceil(each.pushes / RECORD)


def judged(held_out: Lessons, logits: Array) -> PushValidation:
    """By pushes of tables that nothing is learnt from."""
    asked = np.stack([held_out.look, held_out.goal.astype(np.intp)], axis=1)

    def of(which: npt.NDArray[np.bool_]) -> Compared | None:
        return compared(asked[which], held_out.answer[which], logits[which])

    return PushValidation(
        loss=cross_entropy(held_out, logits),
        goal=of(held_out.goal != ALL),
        all=of(held_out.goal == ALL),
    )


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
            explored=each.explored,
            compact=each.compact,
            knots=each.knots,
            hard=each.hard,
            shapes=each.shapes,
        )
        for number in range(first, first + _records(each))
    ]
    with process_pool(course.workers) as pool:
        yield from pool.map(play_pushes, tasks)


def _beside(path: Path, start: Checkpoint) -> TwinNet:
    """A fresh PushNet beside the policy's light network. Raises ConfigError."""
    config = start.config
    if config.network not in ("light", "twin") or config.goal:
        raise ConfigError(
            f"{path}: network is {config.network}, goal is {config.goal}: begin with a light or a "
            "twin one that clears tables"
        )
    torch.manual_seed(0)
    network = TwinNet(goal=False, width=config.width)
    light = start.network()
    network.light.load_state_dict(
        light.light.state_dict() if isinstance(light, TwinNet) else light.state_dict()
    )
    return network


def _freeze(
    course: PushCourse, directory: Path, out: Path, network: TwinNet, start: Checkpoint
) -> Path:
    provenance = provenance_of(
        course,
        start,
        actions=course.pushes,
        validation=read_curve(directory)[-1]["validation"],
    )
    out.mkdir(parents=True, exist_ok=True)
    path = out / WEIGHTS
    config = PolicyConfig(
        network="twin",
        width=start.config.width,
        goal=False,
        method=start.config.method,
    )
    save_checkpoint(path, network, config, provenance)
    return path
