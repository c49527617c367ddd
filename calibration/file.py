"""What was found, as the calibration file that a cell is given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime

from calibration.depth import DepthQuality
from calibration.solve import HandEye
from calibration.table import TablePlane
from calibration.target import CharucoTarget
from tdpg_deploy.calibration_file import (
    BoardSection,
    Calibration,
    CameraSection,
    DepthSection,
    PoseSection,
    QualitySection,
    TableSection,
)
from tdpg_deploy.depth_model import DepthModel
from tdpg_deploy.geometry import Array


def make_calibration(
    found: HandEye,
    target: CharucoTarget,
    *,
    serial: str,
    date: datetime,
    depth: tuple[DepthModel, DepthQuality] | None = None,
    table: TablePlane | None = None,
    tags: Mapping[int, Array] | None = None,
    arm_serial: str | None = None,
    record_sha256: str | None = None,
) -> Calibration:
    lens = found.intrinsics
    position_sd, rotation_sd = found.standard_deviations
    return Calibration(
        mounting=found.mounting.value,
        parent=found.mounting.camera_parent,
        date=date,
        arm_serial=arm_serial,
        camera=CameraSection(
            serial=serial,
            width=lens.width,
            height=lens.height,
            fx=lens.fx,
            fy=lens.fy,
            cx=lens.cx,
            cy=lens.cy,
            distortion=lens.distortion,
            refined=found.lens_refined,
        ),
        pose=PoseSection.of(found.X_parent_camera),
        covariance=tuple(tuple(float(value) for value in row) for row in found.covariance),
        board=BoardSection(
            **asdict(target),
            scale=found.board_scale,
            pose=PoseSection.of(found.X_parent_board),
        ),
        quality=QualitySection(
            position_sd=position_sd,
            rotation_sd=rotation_sd,
            views_used=sum(view.used for view in found.views),
            views_taken=len(found.views),
            rms_px=found.rms,
            pixel_noise_px=found.pixel_noise,
            arm_noise_position=found.pose_noise.translation,
            arm_noise_rotation=found.pose_noise.rotation,
        ),
        depth=None if depth is None else DepthSection(**asdict(depth[0]), **asdict(depth[1])),
        table=None if table is None else TableSection(**asdict(table)),
        record_sha256=record_sha256,
        tags={number: corners.tolist() for number, corners in (tags or {}).items()},
    )
