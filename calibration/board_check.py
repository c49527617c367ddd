"""Is the printed board what it should be? From one photo, and a ruler.

One picture tells whether the board is flat and its squares are square; only a ruler tells how
large it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.closed_form import board_pose
from calibration.detect import Detection
from calibration.projection import project
from calibration.target import CharucoTarget
from calibration.views import View
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

LEAST_SHARE = 0.8  # of the corners: a bend shows at the edges
MOST_SAG = 0.5e-3  # m; moves the camera by less than the arm's own errors
MOST_STRETCH = 1e-3
CERTAIN = 4.0  # standard deviations
MEASURING = 0.5e-3  # m that a ruler is read to


@dataclass(frozen=True, kw_only=True)
class BoardCheck:
    """What a photo shows of the print; each with its standard deviation.

    sag: m from the highest to the lowest point of the board, which should be a plane. stretch:
    length along a row over length along a column, less 1. rms: px that even a bent and stretched
    board leaves. scale: printed over nominal size, None when nothing was measured.
    """

    sag: float
    sag_sd: float
    stretch: float
    stretch_sd: float
    rms: float
    scale: float | None

    def problems(self, target: CharucoTarget) -> list[str]:
        """What to do; empty when the board is good."""
        found = []
        if self.sag > MOST_SAG and self.sag > CERTAIN * self.sag_sd:
            found.append(f"bent by {self.sag * 1e3:.1f} mm: glue it on something stiff and flat")
        if abs(self.stretch) > MOST_STRETCH and abs(self.stretch) > CERTAIN * self.stretch_sd:
            found.append(
                f"rows are {1 + self.stretch:.4f} times as long as columns: print without fitting "
                "to the page, or with another printer"
            )
        if self.scale is not None and abs(self.scale - 1) > MEASURING / target.size[0]:
            found.append(
                f"{self.scale:.4f} of its nominal size: print at 100 %, or give --square "
                f"{target.square * self.scale:.6f} --marker {target.marker * self.scale:.6f}"
            )
        return found


def check_board(
    found: Detection, target: CharucoTarget, lens: Intrinsics, measured: float | None = None
) -> BoardCheck:
    """found: the board in a sharp picture, best tilted and filling it. measured: m along a whole
    row of squares. Raises CalibrationError when the picture does not do."""
    if found.problems:
        raise CalibrationError("; ".join(found.problems))
    corners = target.corners()
    if len(found.ids) < LEAST_SHARE * len(corners):
        raise CalibrationError(
            f"{len(found.ids)} of {len(corners)} corners are seen: show the whole board"
        )
    view = View(
        name="photo",
        X_base_tool=Transform.identity(),
        ids=found.ids,
        corners=found.corners,
    )
    X = board_pose(view, corners, lens)
    flat = corners[found.ids] - corners.mean(axis=0)
    middle = X @ corners.mean(axis=0)

    def residuals(unknown: Array) -> Array:
        turn = X.rotation * Rotation.from_rotvec(unknown[:3])
        p_camera = turn.apply(_printed(flat, unknown[6:])) + middle + unknown[3:6]
        return (project(p_camera, lens)[0] - found.corners).ravel()

    fit = least_squares(residuals, np.zeros(10), x_scale="jac", method="lm")
    freedom = fit.fun.size - fit.x.size
    rms = float(np.sqrt(fit.fun @ fit.fun / freedom))
    jacobian = np.asarray(fit.jac, np.float64)
    covariance = rms**2 * np.linalg.inv(jacobian.T @ jacobian)
    sag, by_bend = _sag(corners - corners.mean(axis=0), fit.x[7:])
    return BoardCheck(
        sag=sag,
        sag_sd=float(np.sqrt(by_bend @ covariance[7:, 7:] @ by_bend)),
        stretch=float(fit.x[6]),
        stretch_sd=float(np.sqrt(covariance[6, 6])),
        rms=rms,
        scale=None if measured is None else measured / target.size[0],
    )


def _bend(flat: Array) -> Array:
    """(n, 3) height by each of the bends x^2, xy, y^2 of 1 per metre."""
    x, y, _ = flat.T
    return np.stack([x * x, x * y, y * y], axis=1)


def _printed(flat: Array, unknown: Array) -> Array:
    """Points (n, 3) of a board whose rows are stretched, and that is bent; unknown: (4,)."""
    points: Array = flat * [1 + unknown[0], 1.0, 1.0]
    points[:, 2] = _bend(flat) @ unknown[1:]
    return points


def _sag(flat: Array, bend: Array) -> tuple[float, Array]:
    """Metres from highest to lowest, and its derivative (3,) by the bend."""
    heights = _bend(flat) @ bend
    by_bend = _bend(flat)[int(heights.argmax())] - _bend(flat)[int(heights.argmin())]
    return float(np.ptp(heights)), by_bend
