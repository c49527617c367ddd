"""GraspNet and Critic II of a twin, put right where they are in doubt: grasps are played and kept,
then both are taught by them. Its PushNet stays as it is.

Records follow from seed and number alone, and each epoch from seed, number and the state saved
after the one before, so a course that was killed goes on as if it had not been.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import torch

from policies.checkpoint import load_checkpoint, save_checkpoint
from policies.networks.twin import TwinNet
from tdpg_deploy.errors import ConfigError
from tools.pool import process_pool
from tools.train.claim import claim
from tools.train.config import GraspCourse, GraspRound
from tools.train.curve import GraspValidation, read_curve
from tools.train.grasps.lessons import GraspLessons, lessons_of
from tools.train.grasps.play import GraspRecord, GraspTask, play_grasps
from tools.train.hold_out import split
from tools.train.run import WEIGHTS, provenance_of
from tools.train.teach import (
    Array,
    Foretell,
    Teacher,
    Tries,
    compared,
    cross_entropy,
    teach_in_rounds,
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

    def play(number: int, first: int) -> Iterator[Path]:
        player = out / f"playing-{number}.safetensors"
        if not player.exists():
            save_checkpoint(player, network, start.config, {})
        return _try(course, course.rounds[number], first, player, out)

    tries = Tries(
        what="grasps tried",
        total=course.grasps,
        size=RECORD,
        play=play,
        lessons_of=_lessons_of,
        judged=judged,
    )
    teach_in_rounds(course, out, teacher, tries, on_progress)
    provenance = provenance_of(
        course, start, actions=course.grasps, validation=read_curve(out)[-1]["validation"]
    )
    path = out / WEIGHTS
    save_checkpoint(path, network, start.config, provenance)
    return path


def _foretell(network: TwinNet) -> Foretell:
    def foretell(cuts: torch.Tensor, places: torch.Tensor) -> tuple[torch.Tensor, ...]:
        _, value, logit = network.light.at(cuts, places)
        return logit, value

    return foretell


def _lessons_of(_number: int, tried: Sequence[Path]) -> tuple[GraspLessons, GraspLessons]:
    """To learn from, and held out."""
    kept, out = split([GraspRecord.load(path) for path in tried], RECORD)
    return lessons_of(kept), lessons_of(out)


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
