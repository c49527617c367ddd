"""The same calibration through the real drivers: a UR controller, a 2F-85, a D435, emulated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from board_in_cell import (
    TARGET,
    X_TOOL_BOARD,
    moved,
    pose_section,
    with_true_camera,
    workspace_grid,
)
from emulated_cell import cubes, emulator, small_cell

from calibration import collection, touch
from calibration.approach import Approach
from calibration.board_camera import BoardCell, PaintedBoard
from calibration.collect import collect
from calibration.collection import Plan, view_of, wanted_points
from calibration.projection import Estimate
from calibration.record import Setup, read_record
from calibration.solve import solve
from calibration.table import workspace_points
from calibration.touch import find_places, touch_all
from calibration.views import Mounting
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.geometry import Transform

TOPS = [(0.42, -0.10), (0.58, 0.12)]


@pytest.mark.slow
@pytest.mark.real_time
def test_collected_solved_and_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collection, "LEAST_VIEWS", 6)  # fewer of all: real time is dear
    monkeypatch.setattr(touch, "FEWEST", 2)
    asked = small_cell()
    X_true = moved(asked.X_base_camera, 0.01, 0.5)
    config = with_true_camera(asked, X_true)
    path = tmp_path / "views.mcap"
    with (
        emulator(config, "--scene", cubes(tmp_path, *TOPS), "--pace", "1") as rig,
        open_cell(rig.config, real=True) as cell,
    ):
        cell.gripper.activate()
        take_views(cell, rig.config, X_true, path)
        found = solved(path, rig.config)
        landed = found @ (X_true.inverse() @ workspace_grid(config))
        assert np.linalg.norm(landed - workspace_grid(config), axis=1).max() < 0.7e-3

        calibrated = with_camera(rig.config, found)
        frame = cell.camera.capture()
        points = workspace_points(frame.depth, frame.intrinsics, found, config.workspace, every=1)
        places = find_places(points, calibrated)[:2]
        touches = touch_all(places, cell.arm, cell.gripper, calibrated, lambda _: None)
        # The emulated camera counts depth in whole millimetres.
        assert np.abs([done.error for done in touches]).max() < 1.5e-3


def take_views(cell: Cell, config: CellConfig, X_true: Transform, path: Path) -> None:
    setup = Setup(mounting=Mounting.EYE_TO_HAND, target=TARGET, workspace=config.workspace)
    plan = Plan(
        setup=setup,
        guess=Estimate(
            X_parent_camera=config.X_base_camera,
            X_parent_board=moved(X_TOOL_BOARD, 0.01, 2.0),
            intrinsics=cell.camera.intrinsics,
        ),
        p_workspace=wanted_points(setup, config.X_base_camera, cell.camera.intrinsics),
        goal=0.3e-3,
    )
    held = PaintedBoard(
        mounting=Mounting.EYE_TO_HAND,
        target=TARGET,
        X_parent_camera=X_true,
        X_parent_board=X_TOOL_BOARD,
    )
    devices = BoardCell(cell.camera, cell.arm, cell.clock, held)
    approach = Approach(config, cell.arm)
    collect(devices, approach, plan, path, np.random.default_rng(0), lambda _: None)


def solved(path: Path, config: CellConfig) -> Transform:
    record = read_record(path)
    assert record.table is not None
    assert record.views[0].serial == "000000000000"
    views = [view for r in record.views if (view := view_of(r, TARGET)[0]) is not None]
    assert len(views) >= 6
    lens = record.views[0].intrinsics
    return solve(views, TARGET.corners(), lens, Mounting.EYE_TO_HAND).X_base_camera


def with_camera(config: CellConfig, X_base_camera: Transform) -> CellConfig:
    camera = config.camera.model_copy(update={"X_base_camera": pose_section(X_base_camera)})
    return config.model_copy(update={"camera": camera})
