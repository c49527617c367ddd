"""From the first picture to the tool on the spot: the mock cell, calibrated by its own arm
through rendered pictures, then sent to where the camera saw points of the table."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.approach import Approach
from calibration.board_camera import BoardCell, PaintedBoard
from calibration.collect import collect
from calibration.collection import Plan, view_of, wanted_points
from calibration.projection import Estimate
from calibration.record import Setup, read_record
from calibration.solve import solve
from calibration.target import DEFAULT_TARGET
from calibration.views import Mounting
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, Pose, load_cell
from tdpg_deploy.geometry import Array, Transform, top_down
from tdpg_deploy.hal import RgbdFrame
from tools.benchmark.measure import Measurement

SEEDS = 3
PLACES = 9  # each way over the workspace
PATCH = 12  # pixels each way whose depth is taken together
HOVER = 0.26  # m over the point: travel height, and a little
FIRST_GUESS = 0.015, np.deg2rad(1.0)  # m, rad that the cell file's camera pose is off by
X_TOOL_BOARD = Transform(
    Rotation.from_euler("z", -92, degrees=True), np.array([0.04, 0.105, -0.005])
)


def measure_landing() -> Measurement:
    """Millimetres between a point of the table and the tool that was sent above it, median and
    5 to 100 % over the workspace."""
    misses = np.concatenate([_landing(seed) for seed in range(SEEDS)])
    low, median, high = 1e3 * np.percentile(misses, [5, 50, 100])
    return Measurement(
        name="mock cell: the tool from where the camera saw the point (highest: worst)",
        unit="mm",
        median=float(median),
        low=float(low),
        high=float(high),
        repeats=len(misses),
    )


def _landing(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    config = load_cell(DEFAULT_CELL)
    X_true = config.X_base_camera @ _random_pose(*FIRST_GUESS, rng)
    config = _with_true_camera(config, X_true)
    with open_cell(config, seed=seed) as cell, tempfile.TemporaryDirectory() as directory:
        found = _calibrate(cell, config, X_true, Path(directory) / "views.mcap", rng)
        frame = cell.camera.capture()  # the arm is at home, the table is empty
        approach = Approach(config, cell.arm)
        misses = []
        for p_base in _places(config):
            p_seen = found @ _see(frame, X_true.inverse() @ p_base)
            above = np.array([0, 0, HOVER])
            x, y, z = (float(value) for value in p_seen + above)
            q = approach.reach(top_down(x, y, z, 0.0))
            assert q is not None
            cell.arm.move_joints(q, speed=1.0, acceleration=1.4, deadline=30.0)
            p_tool = cell.arm.state().X_base_tool.translation - above
            misses.append(float(np.linalg.norm(p_tool - p_base)))
    return np.array(misses)


def _calibrate(
    cell: Cell, config: CellConfig, X_true: Transform, path: Path, rng: np.random.Generator
) -> Transform:
    lens = cell.camera.intrinsics
    mounting, target = Mounting.EYE_TO_HAND, DEFAULT_TARGET
    setup = Setup(mounting=mounting, target=target, workspace=config.workspace)
    plan = Plan(
        setup=setup,
        guess=Estimate(
            X_parent_camera=config.X_base_camera,
            X_parent_board=X_TOOL_BOARD @ _random_pose(*FIRST_GUESS, rng),
            intrinsics=lens,
        ),
        p_workspace=wanted_points(setup, config.X_base_camera, lens),
    )
    held = PaintedBoard(
        mounting=mounting, target=target, X_parent_camera=X_true, X_parent_board=X_TOOL_BOARD
    )
    devices = BoardCell(cell.camera, cell.arm, cell.clock, held)
    collect(devices, Approach(config, cell.arm), plan, path, rng, lambda _: None)
    views = [v for r in read_record(path).views if (v := view_of(r, target)[0]) is not None]
    return solve(views, target.corners(), lens, mounting).X_base_camera


def _see(frame: RgbdFrame, p_camera: Array) -> Array:
    """The point as the frame has it: on its exact ray, at the depth of the surface around it.

    Depth comes in counts of 1 mm; a patch of it is steadier. On a plane 1/z is affine in pixels.
    """
    lens = frame.intrinsics
    u, v = (lens.as_matrix() @ p_camera / p_camera[2])[:2]
    rows, cols = (
        np.arange(round(float(middle)) - PATCH, round(float(middle)) + PATCH + 1)
        for middle in (v, u)
    )
    across, down = np.meshgrid(cols - u, rows - v)
    design = np.column_stack([np.ones(across.size), across.ravel(), down.ravel()])
    inverse = 1 / frame.depth[np.ix_(rows, cols)].astype(np.float64).ravel()
    z = 1 / float(np.linalg.lstsq(design, inverse, rcond=None)[0][0])
    return np.asarray(p_camera / p_camera[2] * z)


def _places(config: CellConfig) -> Array:
    """(n, 3) on the table."""
    inset = 0.01  # m
    (x0, x1), (y0, y1) = config.workspace.x_range, config.workspace.y_range
    x, y = np.linspace(x0 + inset, x1 - inset, PLACES), np.linspace(y0 + inset, y1 - inset, PLACES)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.pad(grid, ((0, 0), (0, 1)), constant_values=config.workspace.table_z)


def _with_true_camera(config: CellConfig, X_base_camera: Transform) -> CellConfig:
    pose = Pose(
        position=tuple(X_base_camera.translation.tolist()),
        quaternion=tuple(X_base_camera.as_quaternion().tolist()),
    )
    simulation = config.simulation.model_copy(update={"X_base_camera": pose, "depth_noise": False})
    return config.model_copy(update={"simulation": simulation})


def _random_pose(metres: float, radians: float, rng: np.random.Generator) -> Transform:
    """Off by so much in a random direction, and about a random axis."""
    along, about = (axis / np.linalg.norm(axis) for axis in rng.normal(size=(2, 3)))
    return Transform(Rotation.from_rotvec(radians * about), metres * along)
