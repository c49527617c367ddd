"""GI's coordinator for a policy that grasps and pushes: a coin tosses between the best push and the
goal's best grasp, each grasp's situation and success are kept, then the classifier learns them.

Records follow from seed and number alone, so a course that was killed goes on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F

from policies.checkpoint import Checkpoint, PolicyConfig, load_checkpoint, save_checkpoint
from policies.coordinator import GRASP, Coordinator, on_goal, situation
from policies.decide import best_grasps, best_push
from policies.heightmap import Heightmap
from policies.networks.coordinated import CoordinatedNet
from policies.policy import Decider, Decision
from policies.primitives import Primitive
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.choosing import is_seen
from tdpg_deploy.episode import run_episode
from tdpg_deploy.episode_record import NullRecorder
from tdpg_deploy.errors import ConfigError, SceneError
from tdpg_deploy.hal import RgbdFrame
from tdpg_deploy.outcome import EndReason, Outcome, Verdict
from tdpg_deploy.sim.clusters import clustered_scene
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.workspace import workspace_of
from tools.pool import process_pool
from tools.train.claim import claim
from tools.train.config import CoordinatorCourse, Randomization
from tools.train.explore import with_choice
from tools.train.hold_out import split
from tools.train.randomize import randomized
from tools.train.rollout import goals
from tools.train.run import WEIGHTS, provenance_of
from tools.train.trainer import training_cell
from tools.train.whole import written_whole

RECORD = 50  # grasps in one file
CLUSTERED = 0.5  # share of the tables; else heaps of ...
HEAP = (5, 30)  # objects

Array = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class CoinTask:
    """Play until so many grasps of goals were made, or a few more; write their record to `file`."""

    weights: Path
    cell: CellConfig
    randomization: Randomization
    seed: tuple[int, ...]
    grasps: int
    file: Path


class CoinToss(NullRecorder):
    """A decider, and what listens to its episodes: situations (n, 5) and successes (n,)."""

    def __init__(self, policy: Decider) -> None:
        self.situations: list[Array] = []
        self.succeeded: list[bool] = []
        self._policy = policy
        self._tried: Array | None = None  # the situation of a grasp whose outcome is not known
        self._goal_seen = False

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        """Of the goal's best grasp and the best push either; the policy's choice where one of them
        is not allowed."""
        decision = self._policy.decide(heightmap, rng, avoid=avoid)
        grasp = on_goal(best_grasps(decision.maps, rng, goal=heightmap.goal, count=1), heightmap)
        push = best_push(decision.maps, rng)
        self._tried = None
        if grasp is None or push is None:
            return decision
        choice = grasp if rng.random() < 0.5 else push
        if choice is grasp:
            self._tried = situation(grasp, push, heightmap, avoid)
        return with_choice(decision, choice, heightmap)

    def observe(self, frame: RgbdFrame, heightmap: Heightmap) -> None:
        assert heightmap.goal is not None
        self._goal_seen = is_seen(heightmap.goal)

    def conclude(self, outcome: Outcome, *, stamp: float) -> None:
        if self._tried is not None and outcome.success is not Verdict.UNKNOWN:
            self.situations.append(self._tried)
            self.succeeded.append(outcome.success is Verdict.YES and not self._goal_seen)


def toss(task: CoinTask) -> Path:
    """Does nothing where the record is there already."""
    import cv2

    if task.file.exists():
        return task.file
    cv2.setNumThreads(1)  # one core a worker
    torch.set_num_threads(1)
    rng = np.random.default_rng(task.seed)
    note = CoinToss(load_checkpoint(task.weights).policy())
    while len(note.succeeded) < task.grasps:
        config = randomized(task.cell, task.randomization, rng)
        workspace = workspace_of(config)
        try:
            if rng.random() < CLUSTERED:
                scene = clustered_scene(workspace, rng)
            else:
                scene = random_scene(int(rng.integers(HEAP[0], HEAP[1] + 1)), workspace, rng)
        except SceneError:
            continue  # too much for the table
        with open_cell(config, scene=scene, seed=int(rng.integers(2**31))) as cell:
            for _ in goals(cell, rng):
                result = run_episode(cell, note, rng=rng, log=note, goal=True)
                if len(note.succeeded) >= task.grasps or result.reason is EndReason.DEVICE_ERROR:
                    break  # an arm that is caught is freed by hand; here, by another cell
    with written_whole(task.file) as file:
        np.savez(file, situations=note.situations, succeeded=note.succeeded)
    return task.file


def teach_coordinator(
    course: CoordinatorCourse, out: Path, *, on_progress: Callable[[str, int, int], None]
) -> Path:
    """Play and teach. Returns the policy's file in `out`: the light network of `course.start`
    with its coordinator. on_progress: is told what is done, how much, and of how much.

    Raises ConfigError when `out` belongs to another course, the policy to begin with has no
    light network that reads a goal, or the grasps make one record only.
    """
    if course.start is None:
        raise ConfigError("a coordinator is for a policy that grasps and pushes: give --from FILE")
    start = load_checkpoint(course.start)
    if start.config.network != "light" or not start.config.goal:
        raise ConfigError(
            f"{course.start}: network is {start.config.network}, goal is {start.config.goal}: "
            "begin with a light network that reads a goal"
        )
    tasks = _tasks(course, course.start, out)
    split(tasks, RECORD)  # too few: said before anything is played
    claim(out, {**course.model_dump(mode="json", exclude={"workers"}), "weights": start.sha256})
    records = []
    with process_pool(course.workers) as pool:
        for file in pool.map(toss, tasks):
            with np.load(file, allow_pickle=False) as record:
                records.append((record["situations"], record["succeeded"]))
            on_progress("grasps made", RECORD * len(records), RECORD * len(tasks))
    kept, held_out = split(records, RECORD)
    torch.manual_seed(course.seed)
    network = CoordinatedNet(goal=True, width=start.config.width)
    network.light.load_state_dict(start.weights)
    teach(network.coordinator, *_joined(kept), course)
    return _freeze(course, out, network, start, judged(network.coordinator, *_joined(held_out)))


def teach(
    coordinator: Coordinator,
    situations: torch.Tensor,
    succeeded: torch.Tensor,
    course: CoordinatorCourse,
) -> None:
    """Cross-entropy on batches of random grasps."""
    optimizer = torch.optim.Adam(coordinator.parameters(), lr=course.learning_rate)
    rng = np.random.default_rng(course.seed)
    for _ in range(course.updates):
        picks = torch.from_numpy(rng.integers(len(succeeded), size=course.batch))
        loss = F.cross_entropy(coordinator(situations[picks]), succeeded[picks])
        optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        optimizer.step()


@torch.no_grad()
def judged(
    coordinator: Coordinator, situations: torch.Tensor, succeeded: torch.Tensor
) -> dict[str, float | None]:
    """By grasps that nothing was learnt from: shares of them that succeeded, whose success was
    foretold rightly, and of those that it would have made that succeeded."""
    made = coordinator(situations).argmax(1) == GRASP
    success = succeeded == GRASP
    return {
        "succeeded": float(success.float().mean()),
        "foretold": float((made == success).float().mean()),
        "made": float(made.float().mean()),
        "succeeded of those made": float(success[made].float().mean()) if made.any() else None,
    }


def _tasks(course: CoordinatorCourse, weights: Path, directory: Path) -> list[CoinTask]:
    cell = training_cell()
    return [
        CoinTask(
            weights=weights,
            cell=cell,
            randomization=course.randomization,
            seed=(course.seed, number),
            grasps=RECORD,
            file=directory / f"{number:04d}.npz",
        )
        for number in range(math.ceil(course.grasps / RECORD))
    ]


def _joined(
    records: Sequence[tuple[Array, npt.NDArray[np.bool_]]],
) -> tuple[torch.Tensor, torch.Tensor]:
    """Situations (n, 5) and classes (n,)."""
    situations, succeeded = (np.concatenate(parts) for parts in zip(*records, strict=True))
    return torch.from_numpy(situations), torch.from_numpy(succeeded.astype(np.int64))


def _freeze(
    course: CoordinatorCourse,
    out: Path,
    network: CoordinatedNet,
    start: Checkpoint,
    validation: dict[str, float | None],
) -> Path:
    provenance = provenance_of(course, start, actions=course.grasps, validation=validation)
    path = out / WEIGHTS
    config = PolicyConfig(network="coordinated", width=start.config.width, goal=True, method="gi")
    save_checkpoint(path, network, config, provenance)
    return path
