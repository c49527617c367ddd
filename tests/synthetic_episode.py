"""A synthetic episode: blocks on a table, seen, decided upon and acted on."""

from __future__ import annotations

import contextlib
import resource
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from policies.heightmap import INSIDE, SIZE, WIDE, Heightmap, Workspace
from policies.policy import CriticVerdict, Decision, QMaps
from policies.primitives import Grasp, Primitive, Push
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.writer import EpisodeWriter
from tdpg_deploy.episode_record import EpisodeRecorder, EpisodeResult
from tdpg_deploy.geometry import Transform, top_down
from tdpg_deploy.hal import ArmState, GripperState, Holding, Intrinsics, RgbdFrame
from tdpg_deploy.outcome import (
    EndReason,
    GraspOutcome,
    Motion,
    Outcome,
    PushOutcome,
    Verdict,
)
from tdpg_deploy.plan import MoveFingers, MoveJoints, MoveLinear, Plan

WORKSPACE = Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15)
COLORS = [(220, 70, 60), (70, 130, 200), (90, 170, 80), (230, 170, 50), (140, 90, 170)]


@dataclass(frozen=True, kw_only=True)
class Call:
    """One call of a recorder."""

    name: str
    arguments: tuple[Any, ...]
    stamp: float | None = None

    def make(self, recorder: EpisodeRecorder) -> None:
        keywords = {} if self.stamp is None else {"stamp": self.stamp}
        getattr(recorder, self.name)(*self.arguments, **keywords)


class Synthetic:
    """Makes the parts of an episode from one seed. Its clock ticks 1/240 s at a reading."""

    def __init__(self, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self._ticks = count()

    def now(self) -> float:
        return 5.0 + next(self._ticks) / 240

    def blocks(self, n: int) -> list[tuple[int, int, tuple[int, int, int]]]:
        places = self.rng.integers(30, SIZE - 30, (n, 2))
        return [(int(r), int(c), COLORS[i % 5]) for i, (r, c) in enumerate(places)]

    def heightmap(
        self, blocks: list[tuple[int, int, tuple[int, int, int]]], *, goal: bool = False
    ) -> Heightmap:
        height = self.rng.normal(0, 0.0008, (SIZE, SIZE)).astype(np.float32)
        color = np.full((SIZE, SIZE, 3), (120, 112, 104), np.uint8)
        for row, col, rgb in blocks:
            patch = np.s_[row - 10 : row + 10, col - 14 : col + 14]
            height[patch] += np.float32(0.03)
            color[patch] = rgb
        unseen = self.rng.random((SIZE, SIZE)) < 0.01
        height[unseen], color[unseen] = np.nan, 0
        mask = np.asarray(height > 0.015) if goal else None
        rim = self.rng.normal(0, 0.0008, (WIDE, WIDE)).astype(np.float32)
        rim[INSIDE, INSIDE] = np.nan
        return Heightmap(workspace=WORKSPACE, color=color, height=height, goal=mask, rim=rim)

    def frame(self, *, width: int = 64, height: int = 48) -> RgbdFrame:
        counts = self.rng.integers(0, 1200, (height, width)).astype(np.uint16)
        depth = counts.astype(np.float32) * np.float32(0.001)
        depth[counts == 0] = np.nan
        return RgbdFrame(
            color=self.rng.integers(0, 256, (height, width, 3), np.uint8),
            depth=depth,
            intrinsics=Intrinsics(
                width=width, height=height, fx=61.7, fy=61.9, cx=31.4, cy=23.6,
                distortion=(0.1, -0.2, 1e-3, -2e-3, 0.05),
            ),
            captured_at=self.now(),
            sequence=int(self.rng.integers(1 << 40)),
            serial="000000000042",
        )  # fmt: skip

    def decision(
        self, blocks: list[tuple[int, int, tuple[int, int, int]]], *, push: bool
    ) -> Decision:
        push_q = self.rng.uniform(0, 0.1, (16, SIZE, SIZE)).astype(np.float32)
        grasp_q = self.rng.uniform(0, 0.1, (16, SIZE, SIZE)).astype(np.float32)
        rows, cols = np.mgrid[:SIZE, :SIZE]
        for row, col, _ in blocks:
            bump = np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / 200).astype(np.float32)
            grasp_q += np.float32(self.rng.uniform(0.4, 0.9)) * bump
            push_q += np.float32(self.rng.uniform(0.2, 0.7)) * np.roll(bump, 18, axis=0)
        push_q[:, :8], grasp_q[3] = -np.inf, -np.inf
        values = push_q if push else grasp_q
        k, row, col = (int(i) for i in np.unravel_index(values.argmax(), values.shape))
        x, y = (float(v) for v in WORKSPACE.to_base(row, col))
        kind: type[Push] | type[Grasp] = Push if push else Grasp
        primitive: Primitive = kind(x=x, y=y, z=-0.12, yaw=k * np.pi / 8)
        return Decision(
            primitive=primitive,
            rotation=k,
            row=row,
            col=col,
            q=float(values[k, row, col]),
            maps=QMaps(push=push_q, grasp=grasp_q),
            verdict=CriticVerdict(p_success=(0.8, 0.55, 0.1), overruled=push),
            seconds={"critic_1": 0.101, "critic_2": 0.021},
            p_foreseen=0.8 if push else None,
        )

    def plan(self, primitive: Primitive) -> Plan:
        def at(z: float) -> Transform:
            return top_down(primitive.x, primitive.y, z, primitive.yaw)

        home = MoveJoints(name="home", q=np.zeros(6), speed=1.0, acceleration=1.4)
        return Plan(
            primitive=primitive,
            approach=(
                MoveLinear(name="above", X_base_tool=at(0.1), speed=0.5, acceleration=1.2),
                MoveLinear(
                    name="descend", X_base_tool=at(-0.14), speed=0.15, acceleration=1.2,
                    stop_force=15.0,
                ),
                MoveFingers(name="close", width=0.0, speed=0.1, force=20.0),
            ),
            retreat=(home,),
            notes=("push shortened from 0.100 to 0.062 m",),
        )  # fmt: skip

    def arm_state(self) -> ArmState:
        return ArmState(
            q=self.rng.normal(size=6),
            qd=self.rng.normal(size=6),
            X_base_tool=Transform(
                Rotation.from_quat(self.rng.normal(size=4)), self.rng.normal(size=3)
            ),
            force=self.rng.normal(size=3),
            stamp=self.now(),
        )

    def gripper_state(self) -> GripperState:
        return GripperState(
            width=float(self.rng.uniform(0, 0.085)),
            moving=False,
            holding=Holding.OBJECT,
            stamp=self.now(),
        )

    def outcome(self, *, push: bool, verdict: Verdict) -> Outcome:
        motion = Motion(contact="descend" if verdict is Verdict.NO else None, seconds=4.2)
        if push:
            return PushOutcome(motion=motion, travelled=0.083, changed=verdict)
        return GraspOutcome(
            motion=motion,
            width_after_close=0.031,
            width_after_lift=float("nan"),
            held_by_width=Verdict.UNKNOWN,
            gone_from_map=verdict,
        )

    def episode(self, actions: int = 3, *, states: int = 4, goal: bool = False) -> list[Call]:
        """In the order that EpisodeRecorder states."""
        verdicts = [Verdict.YES, Verdict.NO, Verdict.UNKNOWN]
        blocks = self.blocks(actions + 1)
        calls = [Call(name="observe", arguments=(self.frame(), self.heightmap(blocks, goal=goal)))]
        for action in range(actions):
            push, verdict = action % 2 == 1, verdicts[action % 3]
            if push:
                refused = self.decision(blocks, push=False)
                reason = "waypoint 3 (0.81, 0.02, 0.11) m lies outside the workspace"
                calls.append(Call(name="refused", arguments=(refused, reason), stamp=self.now()))
            decision = self.decision(blocks, push=push)
            plan = self.plan(decision.primitive)
            calls.append(Call(name="intend", arguments=(decision, plan), stamp=self.now()))
            calls += [Call(name="arm_state", arguments=(self.arm_state(),)) for _ in range(states)]
            calls.append(Call(name="gripper_state", arguments=(self.gripper_state(),)))
            if verdict is Verdict.YES and not push:
                near = [(b[0] - decision.row) ** 2 + (b[1] - decision.col) ** 2 for b in blocks]
                blocks = [b for i, b in enumerate(blocks) if i != int(np.argmin(near))]
            look = (self.frame(), self.heightmap(blocks, goal=goal))
            calls.append(Call(name="observe", arguments=look))
            outcome = self.outcome(push=push, verdict=verdict)
            calls.append(Call(name="conclude", arguments=(outcome,), stamp=self.now()))
        result = EpisodeResult(
            reason=EndReason.ACTION_LIMIT,
            actions=actions,
            grasps=(actions + 1) // 2,
            pushes=actions // 2,
            grasp_successes=1,
            push_successes=0,
            delivered=1,
            refused=actions // 2,
            seconds=31.5,
            truth={"on_table": 3, "lost": 0},
        )
        calls.append(Call(name="end", arguments=(result,), stamp=self.now()))
        return calls


ABOUT = About(
    cell=load_cell(DEFAULT_CELL),
    policy="light",
    started_at=1_764_000_000.25,
    checkpoint_sha256="ab" * 32,
    seed=7,
    command="tdpg-run --objects 10 --seed 7",
    scene="[[object]]\nshape = 'cube'\n",
    commit="0123456789abcdef",
    versions={"numpy": "2.2.6", "torch": "2.7.0"},
)


def write(path: Path, calls: list[Call], *, now: Callable[[], float]) -> None:
    write_about(path, calls, ABOUT, now=now)


def write_about(path: Path, calls: list[Call], about: About, *, now: Callable[[], float]) -> None:
    with EpisodeWriter(path, about, now=now) as writer:
        for call in calls:
            call.make(writer)


@contextlib.contextmanager
def small_disk(size: int) -> Iterator[None]:
    """Within it no file of this process grows beyond so many bytes; the kernel sees to that."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
