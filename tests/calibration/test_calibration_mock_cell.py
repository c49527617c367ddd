"""The mock cell calibrated through rendered pictures: by its arm, by hand, both mountings."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_in_cell import (
    TARGET,
    X_BASE_BOARD,
    X_TOOL_BOARD,
    X_TOOL_CAMERA,
    moved,
    with_true_camera,
    workspace_grid,
)

from calibration.approach import Approach
from calibration.board_camera import BoardCell, PaintedBoard
from calibration.cli import main
from calibration.collect import collect, collect_by_hand
from calibration.collection import Plan, Progress, view_of, wanted_points
from calibration.projection import Estimate
from calibration.record import Setup, read_record
from calibration.solve import solve
from calibration.views import Mounting
from tdpg_deploy.calibration_file import load_calibration
from tdpg_deploy.cell import Cell, open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.emulators.cell_file import format_cell
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Transform

MOCK = load_cell(DEFAULT_CELL)
X_TRUE = moved(MOCK.X_base_camera, 0.015, 1.0)  # from where the cell file has the camera
CONFIG = with_true_camera(MOCK, X_TRUE)
SMALL = CONFIG.model_copy(update={"camera": CONFIG.camera.model_copy(update={"width": 640})})


class Interrupted(Exception):
    pass


def held_board(cell: Cell) -> BoardCell:
    board = PaintedBoard(
        mounting=Mounting.EYE_TO_HAND,
        target=TARGET,
        X_parent_camera=X_TRUE,
        X_parent_board=X_TOOL_BOARD,
    )
    return BoardCell(cell.camera, cell.arm, cell.clock, board)


def plan_for(
    config: CellConfig, mounting: Mounting, cell: Cell, camera: Transform, board: Transform
) -> Plan:
    lens = cell.camera.intrinsics
    setup = Setup(mounting=mounting, target=TARGET, workspace=config.workspace)
    return Plan(
        setup=setup,
        guess=Estimate(X_parent_camera=camera, X_parent_board=board, intrinsics=lens),
        p_workspace=wanted_points(setup, camera, lens),
    )


def held_board_plan(cell: Cell) -> Plan:
    board = moved(X_TOOL_BOARD, 0.01, 2.0)
    return plan_for(CONFIG, Mounting.EYE_TO_HAND, cell, CONFIG.X_base_camera, board)


@pytest.mark.slow
def test_the_tool_lands_where_the_camera_saw_the_point(tmp_path: Path) -> None:
    path = tmp_path / "views.mcap"
    progress: list[Progress] = []

    def interrupt(now: Progress) -> None:
        if len(now.views) == 4:
            raise Interrupted

    with open_cell(CONFIG) as cell:
        plan, devices = held_board_plan(cell), held_board(cell)
        approach = Approach(CONFIG, cell.arm)
        with pytest.raises(Interrupted):
            collect(devices, approach, plan, path, np.random.default_rng(0), interrupt)
        earlier = read_record(path)
        other = replace(plan, setup=replace(plan.setup, target=replace(TARGET, columns=8)))
        with pytest.raises(CalibrationError, match="begun with another board"):
            collect(devices, approach, other, path, np.random.default_rng(0), interrupt)
        collect(devices, approach, plan, path, np.random.default_rng(1), progress.append)
        assert cell.arm.state().q == pytest.approx(np.array(CONFIG.arm.home), abs=1e-3)

    record = read_record(path)
    kept = record.views[: len(earlier.views)]
    assert len(kept) >= 4
    assert [v.stamp for v in kept] == [v.stamp for v in earlier.views]  # resumed, not repeated
    assert record.date == earlier.date
    assert record.table is not None
    assert progress[-1].deviation <= plan.goal
    assert 10 <= len(progress[-1].views) <= 16
    assert progress[-1].coverage.share[:2].min() > 0.9  # across and down the picture

    views = [view for r in record.views if (view := view_of(r, TARGET)[0]) is not None]
    found = solve(views, TARGET.corners(), record.views[0].intrinsics, Mounting.EYE_TO_HAND)
    p_base = workspace_grid(CONFIG)
    landed = found.X_base_camera @ (X_TRUE.inverse() @ p_base)
    assert np.linalg.norm(landed - p_base, axis=1).max() < 0.5e-3

    out, page = tmp_path / "calibration.yaml", tmp_path / "calibration.html"
    files = ["--record", str(path), "--out", str(out), "--report", str(page)]
    assert main(["solve", *files]) == 0
    calibration = load_calibration(out)
    assert calibration.record_sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert calibration.camera.serial == "simulated"
    assert calibration.date == record.date
    assert calibration.depth is not None
    assert abs(calibration.depth.left) < 0.1e-3
    assert calibration.table is not None
    assert calibration.table.height == pytest.approx(CONFIG.workspace.table_z, abs=0.3e-3)
    assert calibration.table.tilt < np.deg2rad(0.05)
    assert max(calibration.pose.transform().distance(found.X_base_camera)) < 1e-9


@pytest.mark.slow
def test_a_camera_on_the_tool(tmp_path: Path) -> None:
    path = tmp_path / "views.mcap"
    camera, board = moved(X_TOOL_CAMERA, 0.01, 2.0), moved(X_BASE_BOARD, 0.02, 2.0)
    with open_cell(SMALL) as cell:
        plan = plan_for(SMALL, Mounting.EYE_IN_HAND, cell, camera, board)
        lying = PaintedBoard(
            mounting=Mounting.EYE_IN_HAND,
            target=TARGET,
            X_parent_camera=X_TOOL_CAMERA,
            X_parent_board=X_BASE_BOARD,
        )
        devices = BoardCell(cell.camera, cell.arm, cell.clock, lying)
        approach = Approach(CONFIG, cell.arm)
        collect(devices, approach, plan, path, np.random.default_rng(0), lambda _: None)
    out = tmp_path / "calibration.yaml"
    files = ["--record", str(path), "--out", str(out), "--report", str(tmp_path / "page.html")]
    assert main(["solve", *files]) == 0
    calibration = load_calibration(out)
    assert calibration.mounting == "eye-in-hand"
    distance, angle = calibration.pose.transform().distance(X_TOOL_CAMERA)
    assert distance < 0.2e-3
    assert np.rad2deg(angle) < 0.02


@pytest.mark.slow
def test_by_hand(tmp_path: Path) -> None:
    """A person, played by the arm, moves to what is proposed; one picture hides the board."""
    path = tmp_path / "views.mcap"
    seen: list[Progress] = []
    with open_cell(SMALL) as cell:
        devices, plan = held_board(cell), held_board_plan(cell)
        approach = Approach(CONFIG, cell.arm)
        to_board = plan.guess.X_parent_camera, plan.guess.X_parent_board

        def person() -> bool:
            """Shows the board about where it is asked for, until it is enough."""
            if seen[-1].deviation < 2 * plan.goal:
                return False
            cell.arm.connect()
            if len(seen) == 1:
                approach.go_home()
            else:
                assert seen[-1].X_camera_board is not None
                camera, board = to_board
                q = approach.reach_by_hand(camera @ seen[-1].X_camera_board @ board.inverse())
                assert q is not None
                cell.arm.move_joints(q, speed=1.0, acceleration=1.4, deadline=60.0)
            cell.arm.close()
            return True

        rng = np.random.default_rng(3)
        reach, hides = approach.reach_by_hand, approach.hides
        collect_by_hand(devices, reach, hides, plan, path, rng, seen.append, person)
    assert seen[1].problems[0].startswith("no board")
    assert seen[1].views == ()
    record = read_record(path)
    assert len(record.views) == len(seen) - 1
    assert len(seen[-1].views) == len(record.views) - 1


@pytest.mark.slow
def test_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell, record = tmp_path / "cell.toml", tmp_path / "views.mcap"
    cell.write_text(format_cell(SMALL))
    held = [str(v) for v in X_TOOL_BOARD.as_rotation_vector()]
    guess = [str(v) for v in moved(X_TOOL_BOARD, 0.01, 1.0).as_rotation_vector()]
    board = ["--columns", "7", "--rows", "5", "--square", "0.024", "--marker", "0.018"]
    arguments = ["collect", "--config", str(cell), "--record", str(record), *board]
    assert main(arguments) == 2
    assert "give --board-pose" in capsys.readouterr().out
    assert main([*arguments, "--mounting", "eye-in-hand", "--board-pose", *held]) == 2
    assert "give --camera-pose" in capsys.readouterr().out
    assert main([*arguments, "--board-pose", *guess, "--paint-board", *held]) == 0
    said = capsys.readouterr().out
    assert "predicted error" in said
    assert "goal 0.100 mm" in said
    picture = cv2.imread(str(record.with_suffix(".png")))
    assert picture is not None
    assert picture.shape == (480, 640, 3)
    out = tmp_path / "calibration.yaml"
    files = ["--record", str(record), "--out", str(out), "--report", str(tmp_path / "page.html")]
    assert main(["solve", *files]) == 0
    assert "tdpg-run will not notice a moved camera" in " ".join(capsys.readouterr().out.split())
    assert load_calibration(out).pose.transform().distance(X_TRUE)[0] < 0.3e-3


def test_a_board_that_is_not_there_is_said(tmp_path: Path) -> None:
    """The mock cell shows none, unless one is painted."""
    path = tmp_path / "views.mcap"
    with open_cell(SMALL) as cell:
        plan, approach = held_board_plan(cell), Approach(SMALL, cell.arm)
        seen: list[Progress] = []
        with pytest.raises(CalibrationError, match="12 pictures could not be used"):
            collect(cell, approach, plan, path, np.random.default_rng(0), seen.append)
    assert seen[-1].problems[0].startswith("no board")
    assert main(["solve", "--record", str(path)]) == 2
