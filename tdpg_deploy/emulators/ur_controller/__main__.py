"""A controller as a process: `python -m tdpg_deploy.emulators.ur_controller --host 127.0.0.1`.

Writes one JSON line when it listens, then answers commands on stdin (see pendant.py), one a
line, and ends with its stdin.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import sys
from pathlib import Path

import numpy as np

from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.emulators.ur_controller.controller import Controller
from tdpg_deploy.emulators.ur_controller.modes import CONTROLLERS, Generation
from tdpg_deploy.emulators.ur_controller.pendant import Pendant
from tdpg_deploy.emulators.ur_controller.plant import KinematicPlant, Plant
from tdpg_deploy.emulators.ur_controller.server import Server


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="loopback address to serve on")
    parser.add_argument("--model", choices=CONTROLLERS, help="of the arm, not the cell's")
    parser.add_argument("--version", help="controller software, as 3.15.8.106339")
    parser.add_argument("--pace", type=float, default=1.0, help="times real time")
    parser.add_argument("--cell", type=Path, default=DEFAULT_CELL, help="where home and table are")
    parser.add_argument("--physics", action="store_true", help="simulate contacts, empty table")
    parser.add_argument("--verbose", action="store_true", help="log to stderr")
    return parser.parse_args()


def _cell(arguments: argparse.Namespace) -> CellConfig:
    cell = load_cell(arguments.cell)
    if arguments.model is None:
        return cell
    return cell.model_copy(update={"arm": cell.arm.model_copy(update={"model": arguments.model})})


def _generation(version: str | None, model: str) -> Generation:
    line = CONTROLLERS[model]
    if version is None:
        return line
    major, minor, bugfix, build = map(int, version.split("."))
    return Generation(version=(major, minor, bugfix, build), frequency=line.frequency)


def _plant(cell: CellConfig, *, physics: bool) -> Plant:
    arm = cell.arm
    if not physics:
        return KinematicPlant(arm.dh, np.array(arm.home), table_z=cell.workspace.table_z)
    from tdpg_deploy.emulators.ur_controller.world_plant import WorldPlant
    from tdpg_deploy.sim.scenes import Scene
    from tdpg_deploy.sim.world import World

    world = World(cell, Scene(objects=()), seed=0)
    world.robot.place(world.robot.joints()[0], 0.0)  # fingers closed
    return WorldPlant(world)


async def _serve(arguments: argparse.Namespace) -> None:
    cell = _cell(arguments)
    plant = _plant(cell, physics=arguments.physics)
    generation = _generation(arguments.version, cell.arm.model)
    controller = Controller(plant, generation, pace=arguments.pace)
    server = Server(controller, arguments.host)
    await server.listen()
    cycles = asyncio.create_task(server.run(pace=arguments.pace))
    commands = asyncio.create_task(_obey(Pendant(server)))
    done, _ = await asyncio.wait({cycles, commands}, return_when=asyncio.FIRST_COMPLETED)
    cycles.cancel()
    await server.unplug()
    for task in done:
        task.result()


async def _obey(pendant: Pendant) -> None:
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    _say({"ok": "listening"})
    while line := await reader.readline():
        _say(await pendant.perform(json.loads(line)))


def _say(answer: object) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    given = _arguments()
    logging.basicConfig(level=logging.DEBUG if given.verbose else logging.WARNING)
    asyncio.run(_serve(given))
