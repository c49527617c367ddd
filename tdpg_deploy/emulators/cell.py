"""A whole cell on the wire: a UR controller, a 2F-85 and a D435 before one simulated world.

One event loop steps the world, as the arm's control cycle. Whoever drives the cell lives in
another process: ur_rtde's constructors hold the interpreter lock while they wait.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.emulators.camera_server import CameraServer
from tdpg_deploy.emulators.cell_file import emulated, serve_gripper
from tdpg_deploy.emulators.robotiq import RobotiqModel
from tdpg_deploy.emulators.robotiq_wires import RobotiqEmulator
from tdpg_deploy.emulators.robotiq_world import WorldJaws
from tdpg_deploy.emulators.ur_controller.controller import Controller
from tdpg_deploy.emulators.ur_controller.modes import CONTROLLERS
from tdpg_deploy.emulators.ur_controller.server import Server
from tdpg_deploy.emulators.ur_controller.world_plant import WorldPlant
from tdpg_deploy.errors import ConfigError
from tdpg_deploy.sim.scenes import Scene
from tdpg_deploy.sim.world import World


@dataclass(frozen=True, kw_only=True, eq=False)
class EmulatedCell:
    """config: the cell file to reach it by. cycles: ends only if the emulator fails."""

    config: CellConfig
    world: World
    arm: Server
    gripper: RobotiqEmulator
    camera: CameraServer
    cycles: asyncio.Task[None]


@contextlib.asynccontextmanager
async def emulated_cell(
    config: CellConfig, scene: Scene, *, seed: int, pace: float
) -> AsyncIterator[EmulatedCell]:
    """A running cell; afterwards its ports and terminals are closed.

    pace: seconds of the cell that pass in one of its clients', as far as the machine can.
    Raises ConfigError when a port is taken, SceneError when the objects do not fit.
    """
    config = emulated(config)
    async with contextlib.AsyncExitStack() as exits:
        world = World(config, scene, seed=seed)
        exits.callback(world.close)
        jaws = WorldJaws(world)
        plant = WorldPlant(world, before_step=jaws.advance)
        generation = CONTROLLERS[config.arm.model]
        arm = Server(Controller(plant, generation, pace=pace), config.arm.host)
        exits.push_async_callback(arm.unplug)
        gripper = exits.enter_context(RobotiqEmulator(RobotiqModel(jaws, world.clock.now)))
        camera = CameraServer(world, config, seed=seed)
        exits.push_async_callback(camera.close)
        assert config.camera.emulated is not None
        try:
            await arm.listen()
            section = serve_gripper(gripper, config.gripper)
            await camera.listen(*config.camera.emulated)
        except OSError as error:
            raise ConfigError(
                f"{config.arm.host}: cannot be served on ({error.strerror}); another emulated "
                "cell? Give this one another loopback address as arm.host, like 127.0.0.2"
            ) from error
        cycles = asyncio.create_task(arm.run(pace=pace))
        exits.push_async_callback(_cancelled, cycles)
        yield EmulatedCell(
            config=config.model_copy(update={"gripper": section}),
            world=world,
            arm=arm,
            gripper=gripper,
            camera=camera,
            cycles=cycles,
        )


async def _cancelled(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
