"""tdpg-calibrate touch: the tool comes down on what the camera sees."""

from __future__ import annotations

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table

from calibration.approach import Approach
from calibration.consent import ask_consent
from calibration.table import workspace_points
from calibration.touch import Touch, find_places, touch_all
from tdpg_deploy.averaging import mean_depth
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell

FRAMES = 15  # still ones; their mean is steadier than what the test is to find
LIMIT = 3e-3  # m; a grasp has half of the thinnest block's height to spare


def run_touch(args: argparse.Namespace, console: Console) -> int:
    from tdpg_deploy.cell import open_cell  # drivers or simulation: only where something moves

    config = load_cell(args.config or DEFAULT_CELL)
    scene = None
    if args.scene is not None:
        from tdpg_deploy.sim.scene_file import load_scene
        from tdpg_deploy.workspace import workspace_of

        scene = load_scene(args.scene, workspace_of(config))
    what = "The arm is going to come down on things on the table, slowly, until it feels them."
    ask_consent(console, what, real=args.real)
    with open_cell(config, real=args.real, scene=scene) as cell:
        approach = Approach(config, cell.arm)
        approach.go_home()
        cell.gripper.activate()
        frames = [cell.camera.capture() for _ in range(FRAMES)]
        depth = mean_depth([frame.depth for frame in frames])
        p_base = workspace_points(
            depth, frames[0].intrinsics, config.X_base_camera, config.workspace, every=1
        )
        places = find_places(p_base, config)

        def tell(done: Touch) -> None:
            x, y, _ = done.p_seen
            console.print(f"({x:.3f}, {y:.3f}) m: met {done.error * 1e3:+.1f} mm from where seen")

        touches = touch_all(places, cell.arm, cell.gripper, config, tell)
    console.print(as_table(touches))
    worst = max(abs(done.error) if np.isfinite(done.height) else np.inf for done in touches)
    if worst > LIMIT:
        console.print(
            f"worse than {LIMIT * 1e3:.0f} mm: one sign and size everywhere is the tool's length "
            "(arm.X_flange_tool) or the depth; a slope is the camera's pose: calibrate anew",
            style="red",
        )
        return 1
    return 0


def as_table(touches: list[Touch]) -> Table:
    table = Table("x m", "y m", "seen z mm", "met z mm", "difference mm")
    for done in touches:
        x, y, z = done.p_seen
        met = f"{done.height * 1e3:.1f}" if np.isfinite(done.height) else "nothing met"
        table.add_row(f"{x:.3f}", f"{y:.3f}", f"{z * 1e3:.1f}", met, f"{done.error * 1e3:+.1f}")
    errors = 1e3 * np.array([done.error for done in touches])
    median, spread = np.nanmedian(errors), np.nanmax(errors) - np.nanmin(errors)
    table.caption = f"median {median:+.2f} mm, {spread:.2f} mm from lowest to highest"
    return table
