"""What is wrong with a set of views, in words: before it is solved, and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from calibration import closed_form
from calibration.closed_form import Start
from calibration.projection import Estimate
from calibration.views import Mounting, PoseNoise, View
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

LEAST_VIEWS = 5
GOOD_VIEWS = 12
REACH = 5.0  # m; no arm with a gripper and a tripod needs more
LEAST_SPREAD = np.deg2rad(4.0)  # rms turn about the second axis of the set
LEAST_SHARE = 0.5
BOARD_TOLERANCE = 0.03  # a printer is off by less
FOCAL_TOLERANCE, CENTRE_TOLERANCE = 0.025, 25.0  # 1, px; a factory's intrinsics are off by less
LOOSE_ARM = 0.3e-3  # m; ten times what a UR repeats to


def check_views(views: Sequence[View], board_corners: int) -> None:
    """Each view in itself, and its units."""
    for view in views:
        if len(view.ids) != len(view.corners) or not np.isfinite(view.corners).all():
            raise CalibrationError(f"view {view.name}: corners are not finite, or not one per id")
        if len(view.ids) < 4 or view.ids.min() < 0 or view.ids.max() >= board_corners:
            raise CalibrationError(
                f"view {view.name}: needs 4 or more corners of the board's {board_corners}, "
                f"has ids {sorted(int(i) for i in view.ids)}"
            )
    far = [view for view in views if np.linalg.norm(view.X_base_tool.translation) > REACH]
    if far:
        distance = float(np.linalg.norm(far[0].X_base_tool.translation))
        hint = "; are the poses in mm? They have to be in m" if distance > 20 else ""
        raise CalibrationError(
            f"view {far[0].name}: the tool is {distance:.4g} m from the base, "
            f"farther than any arm{hint}"
        )


def without_duplicates(views: Sequence[View]) -> tuple[list[View], list[str]]:
    """Views without those that repeat another's picture and pose, and what was noticed.

    Where only one of the two repeats, one of the views is wrong: both stay, and the fit, which
    can tell which, leaves it out.
    """
    kept: list[View] = []
    notes: list[str] = []
    for view in views:
        duplicate = False
        for other in kept:
            distance, angle = view.X_base_tool.distance(other.X_base_tool)
            same_pose = distance < 0.2e-3 and angle < 0.3e-3
            same_picture = _apart(view, other) < 1e-3
            if same_picture and not same_pose:
                notes.append(
                    f"{other.name} and {view.name} are the same picture with poses "
                    f"{distance * 1e3:.1f} mm apart: a stale frame, or pictures and poses mixed up"
                )
            elif same_pose and _apart(view, other) > 5.0:
                notes.append(
                    f"{other.name} and {view.name} have the same pose, but their corners are "
                    f"{_apart(view, other):.0f} px apart: a pose read before the arm had moved, "
                    "or the camera or board was moved"
                )
            elif same_pose:
                duplicate = True
                notes.append(f"{view.name}: duplicate of {other.name}, left out")
                break
        if not duplicate:
            kept.append(view)
    return kept, notes


def _apart(one: View, two: View) -> float:
    """Median distance of common corners, px; infinite if there are none."""
    _, i, j = np.intersect1d(one.ids, two.ids, return_indices=True)
    if not len(i):
        return float("inf")
    return float(np.median(np.linalg.norm(one.corners[i] - two.corners[j], axis=1)))


def check_enough(views: Sequence[View]) -> None:
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(
            f"{len(views)} usable views are too few: add {LEAST_VIEWS - len(views)} or more "
            f"({GOOD_VIEWS} to 15 are good), each turned by 10 degrees or more about another axis"
        )


def check_spread(views: Sequence[View]) -> None:
    """Turns about one axis only, or none, leave the answer undetermined."""
    check_enough(views)
    rotations = Rotation.concatenate([view.X_base_tool.rotation for view in views])
    turns = (rotations.mean().inv() * rotations).as_rotvec()
    _, values, axes = np.linalg.svd(turns / np.sqrt(len(turns)))
    if values[0] < LEAST_SPREAD:
        raise CalibrationError(
            f"the tool was hardly turned between views ({np.rad2deg(values[0]):.1f} degrees rms): "
            "add views tilted by 15 to 30 degrees about two axes of the tool"
        )
    if values[1] < LEAST_SPREAD:
        axis = ", ".join(f"{value:.2f}" for value in axes[0])
        raise CalibrationError(
            f"all turns are about one axis of the tool ({axis}), so the camera's place along it "
            "is undetermined: add views tilted by 15 to 30 degrees about an axis across it"
        )


def consistent_start(
    views: Sequence[View], X_camera_boards: Sequence[Transform], mounting: Mounting
) -> Start:
    """A start that most views agree on; else the error that explains them, if one does."""
    check_spread(views)
    declared = _start(views, X_camera_boards, mounting)
    if declared.agree >= LEAST_SHARE:
        return declared
    explanation = _explain(views, X_camera_boards, mounting, declared)
    if explanation is not None:
        raise CalibrationError(explanation)
    return declared  # the refinement, which weighs every corner, has the last word


def _start(
    views: Sequence[View], X_camera_boards: Sequence[Transform], mounting: Mounting
) -> Start:
    return closed_form.start([view.X_parents(mounting) for view in views], X_camera_boards)


def _explain(
    views: Sequence[View],
    X_camera_boards: Sequence[Transform],
    mounting: Mounting,
    declared: Start,
) -> str | None:
    """Which known mistake makes the pairs agree."""

    def fits(other: Sequence[View], mounted: Mounting = mounting) -> Start | None:
        try:
            check_spread(other)
        except CalibrationError:
            return None
        found = _start(other, X_camera_boards, mounted)
        better = found.agree >= 0.7 and found.agree > declared.agree + 0.3
        return found if better else None

    # Swapping the mounting and inverting every pose are one and the same; only the place of
    # what is found can tell them apart: what hangs on the tool is near the tool.
    swapped = fits(views, mounting.other)
    if swapped is not None:
        camera = float(np.linalg.norm(swapped.X_parent_camera.translation))
        board = float(np.linalg.norm(swapped.X_parent_board.translation))
        camera_on_tool = camera < board
        if camera_on_tool == (mounting is Mounting.EYE_TO_HAND):
            return (
                f"the views contradict {mounting.value} but agree as {mounting.other.value}: "
                f"the camera is {camera:.3f} m from the {mounting.other.camera_parent}; "
                f"choose {mounting.other.value}"
            )
        return (
            "the poses are inverted: they agree when each is taken as the base in the tool's "
            "frame; give X_base_tool, the tool's pose in base"
        )
    for what, repair in _REPAIRS.items():
        if fits(_with_poses(views, repair([view.X_base_tool for view in views]))) is not None:
            return f"the poses do not belong to the pictures as given: they agree when {what}"
    order = _matching_order(views, X_camera_boards, mounting)
    reordered = [views[i].X_base_tool for i in order]
    if (order != np.arange(len(views))).any() and fits(_with_poses(views, reordered)) is not None:
        moved = [f"{views[i].name} has {views[j].name}'s" for i, j in enumerate(order) if i != j]
        return (
            "the poses are out of order: they agree when rearranged; "
            f"{len(moved)} pictures have another's pose ({', '.join(moved[:4])}"
            f"{', ...' if len(moved) > 4 else ''})"
        )
    return None


def _with_poses(views: Sequence[View], poses: Sequence[Transform]) -> list[View]:
    return [replace(view, X_base_tool=pose) for view, pose in zip(views, poses, strict=True)]


def _scalar_first(poses: Sequence[Transform]) -> list[Transform]:
    return [
        Transform.from_quaternion(X.translation, np.roll(X.rotation.as_quat(), -1)) for X in poses
    ]


_REPAIRS: dict[str, Callable[[Sequence[Transform]], Sequence[Transform]]] = {
    "in reverse order": lambda poses: poses[::-1],
    "shifted by one: each picture has the next one's pose": lambda X: [X[-1], *X[:-1]],
    "shifted by one: each picture has the pose before it": lambda X: [*X[1:], X[0]],
    "quaternions are read scalar first (w, x, y, z); give x, y, z, w": _scalar_first,
}


def _matching_order(
    views: Sequence[View], X_camera_boards: Sequence[Transform], mounting: Mounting
) -> npt.NDArray[np.int64]:
    """For each picture the view whose pose turns most alike.

    The angle between two poses of the arm is the angle between the same two board poses,
    whatever the calibration, so a picture and its pose have the same set of angles to the rest.
    """

    def angles(poses: Sequence[Transform]) -> Array:
        R = np.stack([pose.rotation.as_matrix() for pose in poses])
        trace = np.einsum("aij,bij->ab", R, R)
        return np.sort(np.arccos(np.clip((trace - 1) / 2, -1, 1)), axis=1)

    arm = angles([view.X_parents(mounting).inverse() for view in views])
    pictures = angles([X.inverse() for X in X_camera_boards])
    cost = np.abs(pictures[:, None] - arm[None]).sum(axis=2)
    return np.asarray(linear_sum_assignment(cost)[1], np.int64)


def check_share(used: npt.NDArray[np.bool_]) -> None:
    """More than half of the views have to agree with one answer."""
    if used.mean() < LEAST_SHARE or used.sum() < LEAST_VIEWS:
        raise CalibrationError(
            f"only {int(used.sum())} of {len(used)} views agree with each other, and no single "
            "known mistake explains the rest. Check: rotations in radians, not degrees, nor as "
            "roll, pitch, yaw; each pose read with the arm at rest and for its own picture; the "
            "board rigid where it is mounted; the intrinsics of this camera at this resolution"
        )


def check_outcome(
    views: Sequence[View],
    used: npt.NDArray[np.bool_],
    found: Estimate,
    given: Intrinsics,
) -> None:
    """What was found is possible."""
    check_spread([view for view, use in zip(views, used, strict=True) if use])
    lens = found.intrinsics
    focal = max(lens.fx / given.fx - 1, lens.fy / given.fy - 1, key=abs)
    centre = float(np.hypot(lens.cx - given.cx, lens.cy - given.cy))
    if abs(focal) > FOCAL_TOLERANCE or centre > CENTRE_TOLERANCE:
        raise CalibrationError(
            "the intrinsics given are not those of these pictures: the views ask for a focal "
            f"length changed by {focal:+.1%} or more, and a centre {centre:.0f} px away; give this "
            "camera's own, at this resolution"
        )
    if abs(found.scale - 1) > BOARD_TOLERANCE:
        raise CalibrationError(
            f"the board measures {found.scale:.3f} of the size given: "
            "measure a row of its squares, and give that length"
        )


def notes_on_arm(noise: PoseNoise) -> list[str]:
    """What a pose noise (standard deviation) that no arm has at rest may come from."""
    if noise.translation <= LOOSE_ARM:
        return []
    return [
        f"the poses err by {noise.translation * 1e3:.1f} mm, a UR repeats to 0.03 mm: are they the "
        "controller's own, and not from nominal kinematics? Was the board or the camera loose?"
    ]
