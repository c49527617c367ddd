"""Causes planted in the simulated cell's physics, and named by the audit of the logs it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from policies.errors import NoActionError
from policies.heightmap import Heightmap
from policies.policy import Decision, QMaps
from policies.primitives import Grasp, Primitive, Push
from policies.shipped import NamedPolicy
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.errors import ProtectiveStop
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import MotionResult, RgbdFrame
from tdpg_deploy.session import log_episode
from tdpg_deploy.sim.arm import SimArm
from tdpg_deploy.sim.bodies import SHAPES
from tdpg_deploy.sim.camera import SimCamera
from tdpg_deploy.sim.scenes import Scene, SceneObject
from tdpg_deploy.workspace import workspace_of
from tools.audit.causes import Cause
from tools.audit.rows import AuditedLog, audit_log

pytestmark = pytest.mark.slow

MOCK = load_cell(DEFAULT_CELL)
SQUARE = workspace_of(MOCK)
TABLE = SQUARE.table_z


@dataclass
class Script:
    """A decider that says what it was told to, then has nothing to offer."""

    actions: Sequence[Primitive]
    _said: int = field(default=0, init=False)

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        if self._said == len(self.actions):
            raise NoActionError("the script is at its end")
        primitive = self.actions[self._said]
        self._said += 1
        row, col = heightmap.workspace.to_pixel(primitive.x, primitive.y)
        maps = np.zeros((16, 224, 224), np.float32)
        return Decision(
            primitive=primitive, rotation=0, row=int(row), col=int(col), q=0.0,
            maps=QMaps(push=maps, grasp=maps), verdict=None, seconds={},
        )  # fmt: skip


def block(name: str, x: float = 0.5, y: float = 0.0) -> SceneObject:
    shape = SHAPES[name]
    z = TABLE - shape.vertices[:, 2].min() + 0.0005
    pose = Transform(Rotation.identity(), np.array([x, y, z]))
    return SceneObject(shape=shape, X_base_object=pose, rgb=(200, 40, 40))


def cell(**sections: dict[str, Any]) -> CellConfig:
    """The mock cell with other values; carried by the gantry, which is faster."""
    changes: dict[str, dict[str, Any]] = {
        "simulation": {"carrier": "gantry"},
        "episode": {"max_actions": 3},
    }
    for name, values in sections.items():
        changes[name] = changes.get(name, {}) | values
    update = {
        name: getattr(MOCK, name).model_copy(update=values) for name, values in changes.items()
    }
    return MOCK.model_copy(update=update)


def play(
    path: Path, actions: Sequence[Primitive], *objects: SceneObject, **kinds: Any
) -> AuditedLog:
    config = kinds.pop("config", cell())
    policy = NamedPolicy(name="script", decider=Script(actions), sha256=None)
    log_episode(config, policy, path, seed=0, scene=Scene(objects=objects), **kinds)
    return audit_log(path, name="planted")


CUBE_TOP = TABLE + 0.05
MISS = Grasp(x=0.42, y=0.1, z=TABLE, yaw=0.0)
HIT = Grasp(x=0.5, y=0.0, z=CUBE_TOP, yaw=0.0)
NOWHERE = Push(x=0.40, y=0.1, z=TABLE, yaw=0.0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "log.mcap"


def causes(log: AuditedLog) -> list[str | None]:
    return [action.cause for action in log.actions]


def test_a_good_grasp_has_no_cause(path: Path) -> None:
    log = play(path, [HIT], block("cube"))
    assert causes(log) == [None]
    assert (log.episode.reason, log.episode.cause) == ("cleared", None)


def test_grasps_beside_the_object(path: Path) -> None:
    log = play(path, [MISS] * 2, block("cube"), config=cell(episode={"max_failures": 2}))
    assert causes(log) == [Cause.MISSED_GRASP.value, Cause.REPEATED_ACTION.value]
    assert (log.episode.reason, log.episode.cause) == ("stuck", Cause.MISSED_GRASP.value)


def test_an_object_too_smooth_and_heavy_to_lift(path: Path) -> None:
    config = cell(simulation={"friction": 0.1, "density": 5000.0})
    log = play(path, [HIT], block("cube"), config=config)
    assert causes(log) == [Cause.SLIP.value]


def test_a_push_at_nothing(path: Path) -> None:
    log = play(path, [NOWHERE], block("cube", 0.6, -0.1))
    assert causes(log) == [Cause.PUSH_WITHOUT_EFFECT.value]


def test_an_object_pushed_out_of_the_workspace(path: Path) -> None:
    x = SQUARE.x_max - 0.04
    push = Push(x=x - 0.08, y=0.0, z=TABLE, yaw=0.0)
    log = play(path, [push], block("cube", x))
    assert log.episode.lost == 1
    assert Cause.PUSH_OUT_OF_WORKSPACE.value in log.episode.causes


def test_a_hole_in_the_depth_image(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = SimCamera.capture

    def capture(self: SimCamera, *, deadline: float = 2.0) -> RgbdFrame:
        frame = whole(self, deadline=deadline)
        depth = frame.depth.copy()
        depth[260:460, 540:740] = np.nan  # the middle, where the cube is
        return replace(frame, depth=depth)

    monkeypatch.setattr(SimCamera, "capture", capture)
    log = play(path, [HIT], block("cube"), block("cube", 0.65, 0.15))
    assert log.actions[0].refusals == (Cause.DEPTH_HOLE.value,)
    assert log.episode.cause == Cause.DEPTH_HOLE.value


def test_a_push_that_would_leave_the_workspace(path: Path) -> None:
    outwards = Push(x=SQUARE.x_max - 0.01, y=0.0, z=TABLE, yaw=0.0)
    log = play(path, [outwards], block("cube"))
    assert log.actions[0].refusals == (Cause.PUSH_OUT_OF_WORKSPACE.value,)
    assert log.episode.cause == Cause.PUSH_OUT_OF_WORKSPACE.value


def test_an_operator_who_says_no(path: Path) -> None:
    log = play(path, [HIT], block("cube"), confirm=lambda *_: False)
    assert log.episode.cause == Cause.OPERATOR_STOP.value


def test_too_few_actions(path: Path) -> None:
    log = play(path, [MISS], block("cube"), config=cell(episode={"max_actions": 1}))
    assert log.episode.cause == Cause.TIME_OUT.value


def test_an_arm_that_stops_itself(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> MotionResult:
        raise ProtectiveStop("protective stop: the arm met what it could not move")

    monkeypatch.setattr(SimArm, "move_linear", stop)
    log = play(path, [HIT], block("cube"))
    assert log.episode.cause == Cause.PROTECTIVE_STOP.value


def test_a_process_that_was_killed(path: Path) -> None:
    play(path, [HIT], block("cube"))
    cut = path.with_name("log.mcap.part")
    cut.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    assert audit_log(cut, name="cut").episode.cause == Cause.TRUNCATED_LOG.value
