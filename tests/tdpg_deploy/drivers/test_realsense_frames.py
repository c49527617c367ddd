from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tdpg_deploy.drivers.realsense_frames import depth_in_metres, to_intrinsics
from tdpg_deploy.errors import CameraError
from tdpg_deploy.hal import Intrinsics


def test_counts_become_metres_by_the_devices_own_scale() -> None:
    counts = np.array([[0, 1, 1000, 65535]], np.uint16)
    np.testing.assert_allclose(depth_in_metres(counts, 0.001)[0, 1:], [0.001, 1.0, 65.535])
    np.testing.assert_allclose(depth_in_metres(counts, 0.0001)[0, 1:], [0.0001, 0.1, 6.5535])
    assert np.isnan(depth_in_metres(counts, 0.001)[0, 0])
    assert depth_in_metres(counts, 0.001).dtype == np.float32


def rs_intrinsics(model: str, coefficients: list[float]) -> SimpleNamespace:
    return SimpleNamespace(
        width=640, height=480, fx=600.0, fy=601.0, ppx=320.0, ppy=240.0,
        model=f"distortion.{model}", coeffs=coefficients,
    )  # fmt: skip


def test_intrinsics_keep_librealsenses_order_of_coefficients() -> None:
    # rsutil.h: coeffs are k1, k2, p1, p2, k3, as in OpenCV.
    assert to_intrinsics(rs_intrinsics("brown_conrady", [1, 2, 3, 4, 5])) == Intrinsics(
        width=640, height=480, fx=600.0, fy=601.0, cx=320.0, cy=240.0, distortion=(1, 2, 3, 4, 5)
    )


def test_a_distortion_that_is_not_brown_conrady_must_be_zero() -> None:
    assert to_intrinsics(rs_intrinsics("inverse_brown_conrady", [0.0] * 5)).distortion == (0,) * 5
    with pytest.raises(CameraError, match=r"inverse_brown_conrady.*only Brown-Conrady"):
        to_intrinsics(rs_intrinsics("inverse_brown_conrady", [0.1, 0, 0, 0, 0]))
