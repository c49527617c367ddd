"""What tdpg-emulate does: a cell on the wire until Ctrl-C, and an ear for commands."""

from __future__ import annotations

import argparse
import asyncio
import json
import signal
import sys
import threading

import numpy as np

from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.cli.session import choose_scene
from tdpg_deploy.emulators.cell import EmulatedCell, emulated_cell
from tdpg_deploy.emulators.cell_file import format_cell
from tdpg_deploy.emulators.cell_pendant import CellPendant
from tdpg_deploy.emulators.ur_controller.modes import CONTROLLERS
from tdpg_deploy.errors import ConfigError, TdpgError

ENDED, BAD_INPUT = 0, 2


def run_emulation(args: argparse.Namespace) -> int:
    """Emulate what the command line asks for. Returns the exit code."""
    try:
        asyncio.run(_emulate(args))
    except TdpgError as error:
        sys.stderr.write(f"tdpg-emulate: {error}\n")
        return BAD_INPUT
    except KeyboardInterrupt:  # before the cell was up
        pass
    return ENDED


async def _emulate(args: argparse.Namespace) -> None:
    config = load_cell(args.config or DEFAULT_CELL)
    if args.model is not None:
        arm = config.arm.model_copy(update={"model": args.model})
        config = config.model_copy(update={"arm": arm})
    scene = choose_scene(args, config, np.random.default_rng(args.seed))
    async with emulated_cell(config, scene, seed=args.seed, pace=args.pace) as cell:
        ended = asyncio.ensure_future(_ended())
        _listen(CellPendant(cell))
        if args.write_config is not None:
            _write(args, cell.config)
        _say(_greeting(args, cell))
        await asyncio.wait({cell.cycles, ended}, return_when=asyncio.FIRST_COMPLETED)
        if cell.cycles.done():
            cell.cycles.result()


async def _ended() -> None:
    """Until Ctrl-C, or until somebody ends this process politely."""
    asked = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, asked.set)
    await asked.wait()


def _listen(pendant: CellPendant) -> None:
    """Obey lines of standard input, and answer each with a line."""
    loop = asyncio.get_running_loop()

    def hear() -> None:
        # Unbuffered: a buffer that a thread still waits on keeps the interpreter from ending.
        with open(0, "rb", buffering=0, closefd=False) as lines:
            for line in lines:
                if command := line.decode("utf-8", "replace").strip():
                    asyncio.run_coroutine_threadsafe(obey(command), loop)

    async def obey(command: str) -> None:
        _say(json.dumps(await pendant.obey(command)))

    threading.Thread(target=hear, daemon=True).start()


def _write(args: argparse.Namespace, config: CellConfig) -> None:
    try:
        args.write_config.write_text(format_cell(config), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{args.write_config}: cannot be written ({error.strerror})") from error


def _greeting(args: argparse.Namespace, cell: EmulatedCell) -> str:
    arm, gripper, camera = cell.config.arm, cell.config.gripper, cell.config.camera
    assert camera.emulated is not None
    version = ".".join(map(str, CONTROLLERS[arm.model].version[:3]))
    where = gripper.port or f"{gripper.host}:{gripper.tcp_port}"
    file = args.write_config or "FILE"
    return (
        f"{len(cell.world.bodies)} objects on the table, {args.pace:g} times real time\n"
        f"arm      {arm.host} ({arm.dh.name}, PolyScope {version}: RTDE 30004, scripts 30003, "
        f"dashboard 29999)\n"
        f"gripper  {where} ({gripper.driver})\n"
        f"camera   {camera.emulated[0]}:{camera.emulated[1]} (camera.emulated)\n"
        f"connect  tdpg-run --real --config {file}"
        + ("" if args.write_config else "  (--write-config FILE writes it)")
        + f"\ncommands {', '.join(CellPendant.commands())}; Ctrl-C ends"
    )


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
