"""Station sequences of the package kinhec (package index) as cases: a foreign generator's truth.

Eye-to-hand: its Y is the camera in base, its X the board on the flange. Only truth and measured
arm poses are taken; the pixel noise is drawn here.
"""

from __future__ import annotations

import numpy as np
from kinhec import se3  # type: ignore[import-untyped,unused-ignore]
from kinhec.camera import CAMERAS, TARGETS, project_points  # type: ignore[import-untyped,unused-ignore]
from kinhec.config import SequenceConfig  # type: ignore[import-untyped,unused-ignore]
from kinhec.generator import GenerationError, generate_sequence  # type: ignore[import-untyped,unused-ignore]

from calibration.synthetic import Truth
from calibration.views import Mounting, View
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics
from tools.benchmark.calibration_cases import PIXEL_NOISE, POSE_NOISE, VIEWS, Case

BOARD = "checker_7x5_20mm"  # 0.12 x 0.08 m, seen from 0.8 to 1.6 m


def kinhec_case(seed: int) -> Case | None:
    """None where kinhec finds too few poses that its robot reaches."""
    stations = {"mode": "stations", "n_stations": VIEWS, "sync": "synchronous"}
    noise = {
        "models": ["se3_gaussian"],
        "rot_std_rad": POSE_NOISE.rotation,
        "trans_std_m": POSE_NOISE.translation,
        "joint_std_rad": 0.0,
        "student_t_dof": None,
    }
    config = SequenceConfig(
        sequence_id=f"bench-{seed}",
        track="pnp",
        level="bench",
        seed=seed,
        robot="ur5e",
        configuration="eye_to_hand",
        family="lookat",
        family_params={"n_waypoints": VIEWS},
        sampling={**stations, "robot_rate_hz": None},
        robot_noise=noise,
        camera="hd",
        target=BOARD,
    )
    try:
        record = generate_sequence(config)
    except GenerationError:
        return None
    camera, target = CAMERAS[config.camera], TARGETS[BOARD]
    rng = np.random.default_rng([seed, 23])
    tools = _poses(record.robot_table.to_pydict(), "base_ee_meas")
    boards = _poses(record.camera_table.to_pydict(), "cam_target_gt")
    views = []
    for i, (tool, board) in enumerate(zip(tools, boards, strict=True)):
        pixels, _ = project_points(camera, board, target.points)
        views.append(
            View(
                name=f"{i:03d}",
                X_base_tool=Transform.from_matrix(tool),
                ids=np.arange(len(pixels)),
                corners=pixels + rng.normal(0, PIXEL_NOISE, pixels.shape),
            )
        )
    if len(views) < VIEWS:
        return None
    lens = Intrinsics(
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
    )
    truth = Truth(
        mounting=Mounting.EYE_TO_HAND,
        X_parent_camera=Transform.from_matrix(_pose(record.manifest, "Y")),
        X_parent_board=Transform.from_matrix(_pose(record.manifest, "X")),
        intrinsics=lens,
        board_corners=np.asarray(target.points, np.float64),
    )
    return Case(truth=truth, views=views, intrinsics=lens, board_corners=truth.board_corners)


def _poses(columns: dict[str, list[float]], name: str) -> Array:
    """(n, 4, 4)"""
    return np.asarray(se3.pq_to_pose(np.stack([columns[f"{name}_{c}"] for c in _PARTS], axis=1)))


def _pose(row: dict[str, float], name: str) -> Array:
    return np.asarray(se3.pq_to_pose(np.array([row[f"{name}_{c}"] for c in _PARTS])))


_PARTS = ("px", "py", "pz", "qw", "qx", "qy", "qz")
