"""The emulated cell beside the mock cell: the same episodes; and how hard a touch presses.

Each runs tdpg-emulate in a process of its own, and the real drivers here.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from policies.primitives import Primitive
from policies.shipped import NamedPolicy, open_policy
from tdpg_deploy import kinematics
from tdpg_deploy.cell import MachineClock
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.drivers.ur5 import UrArm
from tdpg_deploy.emulators.cell_process import CellProcess
from tdpg_deploy.emulators.ur_controller.process import ControllerProcess
from tdpg_deploy.episode_log.entries import Intent
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.geometry import top_down
from tdpg_deploy.session import log_episode
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.workspace import workspace_of
from tools.benchmark.measure import Measurement

HOST = "127.30.4.1"
SEEDS = range(500, 510)
OBJECTS = 4
PACE = 4
NEAR = 0.01  # m between two places that count as the same
SPEEDS = (0.0125, 0.05, 0.15)  # m/s: touch_speed as tdpg-run starts, and whole; contact_speed
TOUCHES = 5
DEEP = 0.03  # m under the table


def run() -> list[Measurement]:
    """Episodes with the shipped policy; then touches of the table at pace 1."""
    policy, config = open_policy(), _cell()
    episodes = [_episode(config, policy, seed) for seed in SEEDS]
    actions = [same for alike in episodes for same in alike]
    return [
        _share("first action the same", [alike[0] for alike in episodes]),
        _share("actions the same, to the end of the episode", actions),
        *_touches(config),
    ]


def _cell() -> CellConfig:
    """The mock cell, with pictures that cost little to draw and carry no noise of their own."""
    config = load_cell(DEFAULT_CELL)
    camera = {"width": 640, "fps": 6, "max_frame_age": 2.0}
    return config.model_copy(
        update={
            "arm": config.arm.model_copy(update={"host": HOST}),
            "camera": config.camera.model_copy(update=camera),
            "simulation": config.simulation.model_copy(update={"depth_noise": False}),
        }
    )


def _share(name: str, alike: list[bool]) -> Measurement:
    share = float(np.mean(alike))
    return Measurement(
        name=name, unit="of all", median=share, low=share, high=share, repeats=len(alike)
    )


# --- episodes ---------------------------------------------------------------------------------


def _episode(config: CellConfig, policy: NamedPolicy, seed: int) -> list[bool]:
    """Whether each action was the same in both cells; one that only one of them did was not."""
    table = ("--objects", str(OBJECTS), "--seed", str(seed), "--pace", str(PACE))
    with TemporaryDirectory() as directory:
        real, mock = Path(directory) / "real.mcap", Path(directory) / "mock.mcap"
        with CellProcess(config, *table) as process:
            cell = process.config
            log_episode(cell, policy, real, seed=seed, real=True)
        scene = random_scene(OBJECTS, workspace_of(cell), np.random.default_rng(seed))
        log_episode(cell, policy, mock, seed=seed, scene=scene)
        pairs = zip_longest(_actions(real), _actions(mock))
        return [_alike(ours, theirs) for ours, theirs in pairs]


def _actions(log: Path) -> list[Primitive]:
    entries = read_episode(log).entries(images=False, states=False)
    return [entry.decision.primitive for entry in entries if isinstance(entry, Intent)]


def _alike(ours: Primitive | None, theirs: Primitive | None) -> bool:
    if ours is None or theirs is None or type(ours) is not type(theirs):
        return False
    distance = np.hypot(ours.x - theirs.x, ours.y - theirs.y)
    return bool(distance < NEAR and np.isclose(ours.yaw, theirs.yaw))


# --- touches ----------------------------------------------------------------------------------


def _touches(config: CellConfig) -> list[Measurement]:
    """On a table like rubber on wood: KinematicPlant.STIFFNESS."""
    with ControllerProcess(host=HOST) as robot:
        arm = UrArm(config.arm, clock=MachineClock())
        arm.connect()
        try:
            return [_touch(config, robot, arm, speed) for speed in SPEEDS]
        finally:
            arm.close()


def _touch(config: CellConfig, robot: ControllerProcess, arm: UrArm, speed: float) -> Measurement:
    """The largest force while the table ends a descent."""
    limits, (x, y) = config.limits, config.workspace.center
    X_flange_tool = config.arm.X_flange_tool.transform()
    home = np.array(config.arm.home)
    above, below = (
        top_down(x, y, config.workspace.table_z + height, 0.0) for height in (0.03, -DEEP)
    )
    q_above = kinematics.nearest(
        kinematics.inverse(config.arm.dh, above, X_flange_tool), home, (-6.28, 6.28)
    )
    assert q_above is not None
    peaks = []
    for _ in range(TOUCHES):
        arm.move_joints(q_above, speed=1.0, acceleration=1.4, deadline=30.0)
        arm.zero_force()
        with _peak_force(robot) as peak:
            arm.move_linear(
                below,
                speed=speed,
                acceleration=limits.acceleration,
                deadline=30.0,
                stop_force=limits.descend_force,
            )
        peaks.append(max(peak))
    low, median, high = (float(value) for value in np.percentile(peaks, (5, 50, 95)))
    name = f"force of a touch at {speed:g} m/s, guarded at {limits.descend_force:g} N"
    return Measurement(name=name, unit="N", median=median, low=low, high=high, repeats=TOUCHES)


@contextmanager
def _peak_force(robot: ControllerProcess) -> Iterator[list[float]]:
    """Forces at the tool that the emulator feels meanwhile."""
    forces: list[float] = []
    over = threading.Event()

    def watch() -> None:
        while not over.is_set():
            forces.append(float(np.linalg.norm(robot.do("truth")["force"])))

    watching = threading.Thread(target=watch)
    watching.start()
    try:
        yield forces
    finally:
        over.set()
        watching.join()
