"""GraspNet and Critic II of a twin, put right where they are in doubt: grasps are played and kept,
then both are taught by them. Its PushNet stays as it is.

Records follow from seed and number alone, and each epoch from seed, number and the state saved
after the one before, so a course that was killed goes on as if it had not been.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from policies.checkpoint import load_checkpoint, save_checkpoint
from policies.networks.twin import TwinNet
from tdpg_deploy.episode_log import software
from tdpg_deploy.errors import ConfigError
from tools.pool import process_pool
from tools.train import teach
from tools.train.claim import claim
from tools.train.config import GraspCourse, GraspRound
from tools.train.curve import GraspValidation, read_curve
from tools.train.grasps.lessons import GraspLessons, lessons_of
from tools.train.grasps.play import GraspRecord, GraspTask, play_grasps
from tools.train.hold_out import split
from tools.train.run import WEIGHTS, started_with
from tools.train.teach import (
    Array,
    Foretell,
    Teacher,
    Teaching,
    compared,
    cross_entropy,
    restore,
)
from tools.train.trainer import training_cell

RECORD = 200  # grasps in one file


def teach_grasps(
    course: GraspCourse, out: Path, *, on_progress: Callable[[str, int, int], None]
) -> Path:
    """Play and teach, or go on with what `out` holds. Returns the policy's file there:
    `course.start` with other critics of grasps. on_progress: is told what is done, how much, and
    of how much.

    Raises ConfigError when `out` belongs to another course, the policy to begin with is no twin
    that clears tables, or the first round is of one record.
    """
    if course.start is None:
        raise ConfigError("a course of grasps is for a policy that grasps: give --from FILE")
    start = load_checkpoint(course.start)
    network = start.network()
    if not isinstance(network, TwinNet) or start.config.goal:
        raise ConfigError(
            f"{course.start}: network is {start.config.network}, goal is {start.config.goal}: "
            "begin with a twin that clears tables, whose pushes have a network of their own"
        )
    first = math.ceil(course.rounds[0].grasps / RECORD)
    split(range(first), RECORD)  # too few: said before anything is played
    claim(out, {**course.model_dump(mode="json", exclude={"workers"}), "weights": start.sha256})
    teacher = Teacher(network.light, _foretell(network), weight_decay=course.weight_decay)
    epoch = restore(out, teacher)
    tried: list[Path] = []
    ends = 0  # epochs, at the end of a round
    for number, each in enumerate(course.rounds):
        player = out / f"playing-{number}.safetensors"
        if not player.exists():
            save_checkpoint(player, network, start.config, {})
        for record in _try(course, each, len(tried), player, out):
            tried.append(record)
            on_progress("grasps tried", RECORD * len(tried), course.grasps)
        begins, ends = ends, ends + math.ceil(each.updates / teach.EPOCH)
        if epoch < ends:
            _teach(course, each, range(epoch, ends), begins, teacher, tried, on_progress)
            epoch = ends
    provenance: dict[str, Any] = {
        "experiment": course.model_dump(mode="json", exclude={"start"}),
        "start": started_with(start),
        "actions": course.grasps,
        "updates": course.updates,
        "commit": software.commit(),
        "validation": read_curve(out)[-1]["validation"],
    }
    path = out / WEIGHTS
    save_checkpoint(path, network, start.config, provenance)
    return path


def _foretell(network: TwinNet) -> Foretell:
    def foretell(cuts: torch.Tensor, places: torch.Tensor) -> tuple[torch.Tensor, ...]:
        _, value, logit = network.light.at(cuts, places)
        return logit, value

    return foretell


def _teach(
    course: GraspCourse,
    each: GraspRound,
    epochs: range,
    begins: int,
    teacher: Teacher,
    tried: Sequence[Path],
    on_progress: Callable[[str, int, int], None],
) -> None:
    """What is left of a round, whose first epoch is `begins`."""
    lessons, held_out = map(lessons_of, split([GraspRecord.load(path) for path in tried], RECORD))
    Teaching(
        directory=tried[0].parent,
        seed=course.seed,
        updates=each.updates,
        batch=course.batch,
        learning_rate=each.learning_rate,
    ).go_on(
        teacher,
        lessons,
        epochs,
        begins=begins,
        validated=lambda: judged(held_out, teacher.answers(held_out)),
        on_epoch=lambda epoch: on_progress("updates", epoch * teach.EPOCH, course.updates),
    )


def judged(held_out: GraspLessons, logits: Array) -> GraspValidation:
    """By grasps of tables that nothing is learnt from."""
    return GraspValidation(
        loss=cross_entropy(held_out, logits),
        held=compared(held_out.look[:, None], held_out.answer, logits),
    )


def _try(
    course: GraspCourse, each: GraspRound, first: int, player: Path, directory: Path
) -> Iterator[Path]:
    """The records of a round, of which so many are there already."""
    cell = training_cell()
    tasks = [
        GraspTask(
            weights=player,
            cell=cell,
            randomization=course.randomization,
            seed=(course.seed, number),
            grasps=RECORD,
            file=directory / f"{number:04d}.npz",
            compact=course.compact,
        )
        for number in range(first, first + math.ceil(each.grasps / RECORD))
    ]
    with process_pool(course.workers) as pool:
        yield from pool.map(play_grasps, tasks)
