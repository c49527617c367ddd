"""librealsense's frames as values: metres, nan, intrinsics. Pure."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from tdpg_deploy.errors import CameraError
from tdpg_deploy.hal import Intrinsics

Depth = npt.NDArray[np.float32]


def depth_in_metres(counts: npt.NDArray[np.uint16], scale: float) -> Depth:
    """(H, W) counts of `scale` metres -> metres, nan where the camera saw nothing (0)."""
    depth = counts.astype(np.float32)
    depth *= np.float32(scale)
    depth[counts == 0] = np.nan
    return depth


def to_intrinsics(intrinsics: Any) -> Intrinsics:
    """From pyrealsense2. Raises CameraError for a distortion that is not Brown-Conrady."""
    coefficients = tuple(float(c) for c in intrinsics.coeffs)
    model = str(intrinsics.model).rpartition(".")[2]
    # A D435 calls its colour stream's distortion inverse, with all coefficients zero.
    if model != "brown_conrady" and any(coefficients):
        raise CameraError(
            f"colour stream with distortion {model} {coefficients}: only Brown-Conrady is "
            "understood; use a D435"
        )
    k1, k2, p1, p2, k3 = coefficients
    return Intrinsics(
        width=intrinsics.width,
        height=intrinsics.height,
        fx=intrinsics.fx,
        fy=intrinsics.fy,
        cx=intrinsics.ppx,
        cy=intrinsics.ppy,
        distortion=(k1, k2, p1, p2, k3),
    )


def same_camera(depth: Any, color: Any) -> bool:
    """Whether two stream profiles see through the same lens: nothing is left to align."""
    offset = depth.get_extrinsics_to(color)
    return (
        to_intrinsics(depth.get_intrinsics()) == to_intrinsics(color.get_intrinsics())
        and np.array_equal(np.reshape(offset.rotation, (3, 3)), np.eye(3))
        and not np.any(offset.translation)
    )
