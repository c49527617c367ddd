"""A cell, simulated or real. `open_cell` is the sole place that knows which."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from tdpg_deploy.calibrated_camera import CalibratedCamera
from tdpg_deploy.cell_config import CameraSection, CellConfig
from tdpg_deploy.hal import Arm, Camera, Clock, Gripper, RgbdFrame

if TYPE_CHECKING:
    from tdpg_deploy.drivers.realsense import RealsenseCamera
    from tdpg_deploy.sim.scenes import Scene

Truth: TypeAlias = Callable[[], Mapping[str, int]]
GoalPixels: TypeAlias = Callable[[RgbdFrame], npt.NDArray[np.bool_]]


def open_cell(
    config: CellConfig, *, real: bool = False, scene: Scene | None = None, seed: int = 0
) -> Cell:
    """The cell's devices, not yet connected: `with open_cell(config) as cell:` connects them.

    scene: what lies on the simulated table, None for nothing; seed: of how it falls and of the
    camera's noise. Both are for the simulated cell only.
    """
    return _real_cell(config) if real else _simulated_cell(config, scene, seed)


class Cell:
    """Devices of one cell. `with cell:` connects them; on any exit the arm is stopped and all
    are closed, the last one first, even when one of them fails.

    Frames are put right by the calibration that the cell file names, if it names one.

    goal_pixels: (H, W) of the frame just taken, where it shows the object to fetch; None where
    nothing can tell. truth: counts that only a simulated world knows; for judging, never for
    deciding.
    """

    def __init__(
        self,
        *,
        config: CellConfig,
        camera: Camera,
        arm: Arm,
        gripper: Gripper,
        clock: Clock,
        goal_pixels: GoalPixels | None = None,
        truth: Truth | None = None,
        release: Callable[[], None] | None = None,
    ) -> None:
        self.config = config
        calibration = config.camera.calibration
        self.camera = camera if calibration is None else CalibratedCamera(camera, calibration)
        self.arm = arm
        self.gripper = gripper
        self.clock = clock
        self.goal_pixels = goal_pixels
        self.truth = truth
        self._release = release
        self._exits = ExitStack()

    def __enter__(self) -> Cell:
        with ExitStack() as exits:
            if self._release is not None:
                exits.callback(self._release)
            for device in (self.arm, self.gripper, self.camera):  # the one to fear first
                exits.callback(device.close)  # also when its connect fails half-way
                device.connect()
            exits.callback(self.arm.stop)
            self._exits = exits.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._exits.__exit__(kind, error, traceback)


class MachineClock:
    """This machine's time; never steps back when the wall clock is set."""

    def __init__(self) -> None:
        self._offset = time.time() - time.monotonic()

    def now(self) -> float:
        return time.monotonic() + self._offset

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


def realsense_camera(section: CameraSection, *, clock: Clock) -> RealsenseCamera:
    """The camera of a cell file: on USB, recorded or emulated. Opens nothing."""
    from tdpg_deploy.drivers.realsense import RealsenseCamera

    if section.emulated is None:
        return RealsenseCamera(section, clock=clock)
    from tdpg_deploy.emulators.frame_wire import RemoteFrames
    from tdpg_deploy.emulators.realsense import EMULATED_SERIAL, EmulatedD435, arriving_late

    frames = RemoteFrames(*section.emulated)
    source = EmulatedD435(frames, serial=section.serial or EMULATED_SERIAL)
    source.fault = arriving_late(lambda: frames.ages)
    return RealsenseCamera(section, clock=clock, source=source)


def _real_cell(config: CellConfig) -> Cell:
    from tdpg_deploy.drivers.robotiq import robotiq_gripper
    from tdpg_deploy.drivers.ur5 import UrArm

    clock = MachineClock()
    return Cell(
        config=config,
        camera=realsense_camera(config.camera, clock=clock),
        arm=UrArm(config.arm, clock=clock),
        gripper=robotiq_gripper(config.gripper, arm_host=config.arm.host, clock=clock),
        clock=clock,
    )


def _simulated_cell(config: CellConfig, scene: Scene | None, seed: int) -> Cell:
    from tdpg_deploy.sim.arm import SimArm
    from tdpg_deploy.sim.camera import SimCamera
    from tdpg_deploy.sim.goal import GoalDetector
    from tdpg_deploy.sim.gripper import SimGripper
    from tdpg_deploy.sim.scenes import Scene
    from tdpg_deploy.sim.world import Where, World

    scene = scene or Scene(objects=())
    world = World(config, scene, seed=seed)
    goals = [index for index, item in enumerate(scene.objects) if item.goal]

    def truth() -> dict[str, int]:
        places = [state.where for state in world.objects()]
        return {where.value: places.count(where) for where in Where}

    return Cell(
        config=config,
        camera=SimCamera(world, config, seed=seed),
        arm=SimArm(world),
        gripper=SimGripper(world),
        clock=world.clock,
        goal_pixels=GoalDetector(world, goals),
        truth=truth,
        release=world.close,
    )
