"""What tdpg-run does: episodes on one cell, each with its log and its picture."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from rich.console import Console

from policies.errors import PolicyError
from policies.shipped import NamedPolicy, open_policy
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.cli.live import Live
from tdpg_deploy.cli.recovery import offer_recovery
from tdpg_deploy.episode import Confirm
from tdpg_deploy.episode_log.summary import write_summary
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import ConfigError, DeviceError, LogError, TdpgError
from tdpg_deploy.outcome import EndReason
from tdpg_deploy.session import log_episode
from tdpg_deploy.sim.scene_file import load_scene
from tdpg_deploy.sim.scenes import Scene, random_scene
from tdpg_deploy.workspace import workspace_of

DONE, SHORT, BAD_INPUT, DEVICE_FAILED, LOG_FAILED, STOPPED = 0, 1, 2, 3, 4, 130
CODES = {
    EndReason.CLEARED: DONE,
    EndReason.GOAL_REACHED: DONE,
    EndReason.DEVICE_ERROR: DEVICE_FAILED,
    EndReason.OPERATOR_STOP: STOPPED,
}  # every other end falls short
REAL_SPEED = 0.25  # share of the cell's limits, until somebody asks for more


def run_session(args: argparse.Namespace) -> int:
    """Run what the command line asks for. Returns the exit code, the worst of all episodes."""
    console = Console(highlight=False)
    with interruptible():
        code = _run_all(args, console)
        if code == DEVICE_FAILED and args.real and not args.unattended:
            with suppress(KeyboardInterrupt):
                offer_recovery(console, load_cell(args.config or DEFAULT_CELL).arm)
        return code


@contextmanager
def interruptible() -> Iterator[None]:
    """SIGINT and SIGTERM stop the arm and close the log, even where a shell that started us in
    the background had us ignore them."""
    signals = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, signal.default_int_handler) for number in signals]
    try:
        yield
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)


def _run_all(args: argparse.Namespace, console: Console) -> int:
    try:
        config = load_cell(args.config or DEFAULT_CELL)
        config = slowed(config, args.speed or (REAL_SPEED if args.real else 1.0))
        policy = open_policy(args.policy, goal=args.goal)
        if args.real and not args.unattended:
            ask_consent(console, config, policy)
        code = DONE
        for number in range(args.episodes):
            code = max(code, _run_one(args, console, config, policy, args.seed + number))
            if code in (DEVICE_FAILED, STOPPED):
                break
    except DeviceError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        return DEVICE_FAILED
    except LogError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        return LOG_FAILED
    except (TdpgError, PolicyError) as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        return BAD_INPUT
    except KeyboardInterrupt:
        console.print("stopped")
        return STOPPED
    return code


def _run_one(
    args: argparse.Namespace, console: Console, config: CellConfig, policy: NamedPolicy, seed: int
) -> int:
    scene = None if args.real else choose_scene(args, config, np.random.default_rng(seed))
    stamp = time.strftime("%Y%m%d-%H%M%S")
    path = args.out / f"{stamp}-{config.name}-seed{seed}.mcap"
    objects = None if scene is None else len(scene.objects)
    with Live(console, objects=objects) as live:
        result = log_episode(
            config,
            policy,
            path,
            seed=seed,
            real=args.real,
            scene=scene,
            goal=args.goal,
            watch=live.before,
            confirm=_confirmation(args, live),
        )
    picture = path.with_suffix(".png")
    write_summary(path, picture)
    _report(console, result, path, picture)
    return CODES.get(result.reason, SHORT)


def _confirmation(args: argparse.Namespace, live: Live) -> Confirm | None:
    """Whom to ask before an action: the person who stands by, for the first or for each."""
    if args.step:
        return live.confirm
    return live.confirm_first if args.real and not args.unattended else None


def choose_scene(args: argparse.Namespace, config: CellConfig, rng: np.random.Generator) -> Scene:
    """From the file, or random; with a goal where one is asked for. Raises SceneError."""
    workspace = workspace_of(config)
    if args.scene is None:
        scene = random_scene(args.objects, workspace, rng)
        return scene.with_goal(int(rng.integers(args.objects))) if args.goal else scene
    scene = load_scene(args.scene, workspace)
    if args.goal and not any(item.goal for item in scene.objects):
        raise ConfigError(f"--goal: no object of {args.scene} is marked goal = true: mark one")
    return scene


def slowed(config: CellConfig, share: float) -> CellConfig:
    """The cell with its limits on speed and acceleration scaled."""
    limits = config.limits
    speeds = ("joint_speed", "travel_speed", "contact_speed", "touch_speed")
    names = (*speeds, "joint_acceleration", "acceleration")
    scaled = {name: getattr(limits, name) * share for name in names}
    return config.model_copy(update={"limits": limits.model_copy(update=scaled)})


def ask_consent(console: Console, config: CellConfig, policy: NamedPolicy) -> None:
    """Before the real arm moves for the first time. Raises ConfigError without a yes."""
    arm, limits = config.arm, config.limits
    console.print(
        f"The {arm.dh.name} at {arm.host} is going to move: home, then policy {policy.name}.\n"
        f"At most {limits.travel_speed:.2f} m/s in free space, {limits.contact_speed:.2f} m/s near "
        f"objects, {limits.touch_speed:.3f} m/s onto them; it stops above "
        f"{limits.descend_force:.0f} N going down and {limits.push_force:.0f} N pushing.\n"
        f"{describe_calibration(config)}\n"
        "Keep clear, and a hand at the emergency stop. Ctrl-C stops the arm."
    )
    if not sys.stdin.isatty():
        raise ConfigError(
            "--real asks before it moves, and nobody can answer here: use --unattended to say "
            "that nobody stands by the arm"
        )
    if console.input("Type yes to go on: ").strip().lower() != "yes":
        raise ConfigError("nothing was moved: the answer was not yes")


def describe_calibration(config: CellConfig) -> str:
    """How the camera's pose came to be known, in a sentence."""
    calibration = config.camera.calibration
    if calibration is None:
        return (
            "The camera's pose is typed into the cell file: its error is not known, and a moved "
            "camera will not be noticed. tdpg-calibrate makes a calibration."
        )
    watch = (
        f"{len(calibration.tags)} table tags tell whether it has moved since"
        if calibration.tags
        else "no table tags were seen, so a moved camera will not be noticed"
    )
    return (
        f"The camera was calibrated {calibration.age().days} days ago to "
        f"{calibration.quality.position_sd * 1e3:.2f} mm; {watch}."
    )


def _report(console: Console, result: EpisodeResult, path: Path, picture: Path) -> None:
    share = f" ({result.grasp_successes / result.grasps:.0%})" if result.grasps else ""
    console.print(
        f"[bold]{result.reason.value}[/]: {result.grasp_successes} of {result.grasps} grasps"
        f"{share}, {result.pushes} pushes, {result.refused} refused, "
        f"{result.seconds:.0f} s of the robot's time",
        soft_wrap=True,
    )
    if result.error:
        console.print(result.error, style="red", markup=False)
    if result.truth:
        console.print("  ".join(f"{key}: {value}" for key, value in result.truth.items()))
    console.print(f"log      {path}\npicture  {picture}", markup=False, soft_wrap=True)
