"""The mock cell calibrated through rendered pictures: collect, interrupt, resume, solve."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.approach import Approach
from calibration.cli import main
from calibration.collect import Plan, Progress, collect, view_of
from calibration.pictures import paint_board
from calibration.projection import Estimate
from calibration.record import read_record
from calibration.solve import solve
from calibration.target import CharucoTarget
from calibration.views import Mounting
from tdpg_deploy.calibration_file import load_calibration
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, Pose, load_cell
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Arm, Camera, Clock, Intrinsics, RgbdFrame

TARGET = CharucoTarget(columns=7, rows=5, square=0.024, marker=0.018)
# Held by an edge before the fingers, its face against the tool's axis.
X_TOOL_BOARD = Transform(
    Rotation.from_euler("z", -92, degrees=True), np.array([0.04, 0.084, -0.005])
)


class Interrupted(Exception):
    pass


class BoardCamera:
    """The simulated camera, with the board painted where the tool holds it."""

    def __init__(self, camera: Camera, arm: Arm, X_base_camera: Transform) -> None:
        self._camera, self._arm, self._X_base_camera = camera, arm, X_base_camera

    @property
    def intrinsics(self) -> Intrinsics:
        return self._camera.intrinsics

    def connect(self) -> None:
        self._camera.connect()

    def close(self) -> None:
        self._camera.close()

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        frame = self._camera.capture(deadline=deadline)
        X_camera_board = (
            self._X_base_camera.inverse() @ self._arm.state().X_base_tool @ X_TOOL_BOARD
        )
        depth = frame.depth.copy()
        color = paint_board(frame.color, TARGET, X_camera_board, frame.intrinsics, depth)
        return replace(frame, color=color, depth=depth)


class HeldBoard:
    """A cell whose camera sees the board."""

    def __init__(self, cell: Cell, X_base_camera: Transform) -> None:
        self.arm: Arm = cell.arm
        self.clock: Clock = cell.clock
        self.camera: Camera = BoardCamera(cell.camera, cell.arm, X_base_camera)


def pose_section(X: Transform) -> Pose:
    x, y, z = (float(v) for v in X.translation)
    qx, qy, qz, qw = (float(v) for v in X.as_quaternion())
    return Pose(position=(x, y, z), quaternion=(qx, qy, qz, qw))


def moved(X: Transform, metres: float, degrees: float) -> Transform:
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array([0.6, -0.64, 0.48]))
    return X @ Transform(turn, metres * np.array([0.6, -0.64, 0.48]))


@pytest.fixture
def config() -> CellConfig:
    """The mock cell with its camera 15 mm and 1 degree from where the cell file has it."""
    base = load_cell(DEFAULT_CELL)
    true = moved(base.X_base_camera, 0.015, 1.0)
    simulation = base.simulation.model_copy(
        update={"X_base_camera": pose_section(true), "depth_noise": False}
    )
    return base.model_copy(update={"simulation": simulation})


def workspace(config: CellConfig) -> Array:
    x, y = config.workspace.center
    side = np.linspace(-0.22, 0.22, 5)
    grid = np.stack(np.meshgrid(x + side, y + side), axis=-1).reshape(-1, 2)
    heights = [config.workspace.table_z, config.workspace.table_z + 0.1]
    return np.array([[a, b, z] for a, b in grid for z in heights])


@pytest.mark.slow
def test_the_tool_lands_where_the_camera_saw_the_point(config: CellConfig, tmp_path: Path) -> None:
    assert config.simulation.X_base_camera is not None
    X_true = config.simulation.X_base_camera.transform()
    path = tmp_path / "views.mcap"
    corners = TARGET.corners()
    progress: list[Progress] = []

    with open_cell(config) as cell:
        plan = Plan(
            mounting=Mounting.EYE_TO_HAND,
            target=TARGET,
            guess=Estimate(
                X_parent_camera=config.X_base_camera,
                X_parent_board=moved(X_TOOL_BOARD, 0.01, 2.0),
                intrinsics=cell.camera.intrinsics,
            ),
            p_workspace=workspace(config),
            table_z=config.workspace.table_z,
        )
        held = HeldBoard(cell, X_true)
        approach = Approach(config, cell.arm)

        def interrupt(now: Progress) -> None:
            if now.views == 4:
                raise Interrupted

        with pytest.raises(Interrupted):
            collect(held, approach, plan, path, np.random.default_rng(0), interrupt)
        earlier = read_record(path)
        assert earlier
        taken = collect(held, approach, plan, path, np.random.default_rng(1), progress.append)
        assert cell.arm.state().q == pytest.approx(np.array(config.arm.home), abs=1e-3)

    record = read_record(path)
    assert [view.name for view in record] == [view.name for view in taken]
    assert record[0].stamp == earlier[0].stamp  # resumed, not repeated
    assert progress[-1].deviation <= plan.goal
    assert 10 <= progress[-1].views <= 16

    views = [view for r in record if (view := view_of(r, TARGET)[0]) is not None]
    found = solve(views, corners, record[0].intrinsics, Mounting.EYE_TO_HAND)
    p_base = workspace(config)
    landed = found.X_base_camera @ (X_true.inverse() @ p_base)
    assert np.linalg.norm(landed - p_base, axis=1).max() < 0.5e-3

    board = ["--columns", "7", "--rows", "5", "--square", "0.024", "--marker", "0.018"]
    out = tmp_path / "calibration.yaml"
    page = tmp_path / "calibration.html"
    files = ["--record", str(path), "--out", str(out), "--report", str(page)]
    assert main(["solve", *files, *board]) == 0
    calibration = load_calibration(out)
    assert calibration.record_sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert calibration.camera.serial == "simulated"
    assert calibration.depth is not None
    assert abs(calibration.depth.left) < 0.1e-3
    distance, angle = calibration.pose.transform().distance(found.X_base_camera)
    assert max(distance, angle) < 1e-9
