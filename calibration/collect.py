"""Take views until the predicted error is small enough: by the arm's own motion, or by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from calibration.detect import detect
from calibration.poses import best_next, candidates, predicted_deviation
from calibration.projection import Estimate
from calibration.record import RecordedView, RecordWriter, read_record
from calibration.refine import Freedom
from calibration.solve import solve
from calibration.target import CharucoTarget
from calibration.views import Mounting, PoseNoise, View
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Arm, Camera, Clock

SETTLE = 0.4  # s from the end of a motion to a picture; a UR5 with a board swings for less
LEAST_VIEWS, MOST_VIEWS, MOST_FAILURES = 10, 25, 12
STILL = 0.2e-3  # m that the tool may move during a picture


class Devices(Protocol):
    """What is needed of a cell."""

    @property
    def camera(self) -> Camera: ...
    @property
    def arm(self) -> Arm: ...
    @property
    def clock(self) -> Clock: ...


class Mover(Protocol):
    """What moves the arm; see calibration.approach."""

    def reach(self, X_base_tool: Transform) -> Array | None: ...
    def go(self, q: Array) -> None: ...
    def go_home(self) -> None: ...


@dataclass(frozen=True, kw_only=True)
class Progress:
    """After each picture. problems: why it was not used; deviation: predicted (m)."""

    name: str
    views: int
    deviation: float
    problems: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """What is to be found, and from where.

    guess: both poses within some centimetres and degrees. goal: metres, root mean variance of
    points of the workspace. p_workspace: (n, 3) in the camera's parent frame. table_z: metres
    in base, for a held board to stay clear of.
    """

    mounting: Mounting
    target: CharucoTarget
    guess: Estimate
    p_workspace: Array
    table_z: float
    goal: float = 0.1e-3
    pose_noise: PoseNoise = field(default_factory=PoseNoise)


def view_of(recorded: RecordedView, target: CharucoTarget) -> tuple[View | None, tuple[str, ...]]:
    """The view, or why there is none."""
    found = detect(recorded.color, target)
    if found.problems:
        return None, found.problems
    view = View(
        name=recorded.name,
        X_base_tool=recorded.X_base_tool,
        ids=found.ids,
        corners=found.corners,
    )
    return view, ()


def take(devices: Devices, name: str) -> RecordedView:
    """A picture with the arm at rest. Raises CalibrationError if it moved meanwhile."""
    before = devices.arm.state()
    frame = devices.camera.capture()
    after = devices.arm.state()
    moved = before.X_base_tool.distance(after.X_base_tool)[0]
    if moved > STILL:
        raise CalibrationError(
            f"the tool moved by {moved * 1e3:.2f} mm while the picture was taken: hold it still"
        )
    return RecordedView(
        name=name,
        color=frame.color,
        depth=frame.depth,
        intrinsics=frame.intrinsics,
        serial=frame.serial,
        q=after.q,
        X_base_tool=after.X_base_tool,
        stamp=after.stamp,
        captured_at=frame.captured_at,
    )


def collect(
    devices: Devices,
    mover: Mover,
    plan: Plan,
    path: Path,
    rng: np.random.Generator,
    on_progress: Callable[[Progress], None],
) -> list[RecordedView]:
    """Move, look, choose again. Resumes `path` if it exists; ends with the arm at home.

    Raises CalibrationError when the goal is out of reach, with the views taken kept in `path`.
    """
    earlier = read_record(path) if path.exists() else []
    taken: list[RecordedView] = []
    views: list[View] = []
    failures = 0
    partial = path.with_name(path.name + ".partial")
    with RecordWriter(partial) as writer:

        def keep(recorded: RecordedView) -> None:
            nonlocal failures
            writer.add(recorded)
            taken.append(recorded)
            view, problems = view_of(recorded, plan.target)
            if view is None:
                failures += 1
            else:
                views.append(view)
            on_progress(
                Progress(
                    name=recorded.name,
                    views=len(views),
                    deviation=_deviation(views, plan, refined_guess(views, plan)),
                    problems=problems,
                )
            )

        for recorded in earlier:
            keep(recorded)
        # The file grows under its own name from here on, so that it can be resumed.
        partial.replace(path)
        while not _enough(views, plan):
            if failures >= MOST_FAILURES or len(views) >= MOST_VIEWS:
                raise CalibrationError(
                    f"{len(views)} views give {_deviation(views, plan, plan.guess) * 1e3:.2f} mm, "
                    f"{failures} pictures could not be used: check light, board and first guess; "
                    f"{path} keeps what was taken"
                )
            guess = refined_guess(views, plan)
            corners = plan.target.corners()
            offered = candidates(guess, plan.mounting, corners, mover.reach, plan.table_z, rng)
            if not offered:
                raise CalibrationError(
                    "no reachable pose shows the board: check the first guess of the camera's and "
                    "the board's pose in the cell file"
                )
            poses = [candidate.X_base_tool for candidate in offered]
            seen = [view.X_base_tool for view in views]
            choice = best_next(
                poses, seen, guess, plan.mounting, corners, plan.p_workspace, plan.pose_noise
            )
            mover.go(offered[choice.index].q)
            devices.clock.sleep(SETTLE)
            keep(take(devices, f"{len(taken):03d}"))
        mover.go_home()
    return taken


def refined_guess(views: Sequence[View], plan: Plan) -> Estimate:
    """Solved from the views so far once they suffice, else the first guess."""
    if len(views) < LEAST_VIEWS - 4:
        return plan.guess
    try:
        found = solve(
            views, plan.target.corners(), plan.guess.intrinsics, plan.mounting, freedoms=[Freedom()]
        )
    except CalibrationError:
        return plan.guess
    return Estimate(
        X_parent_camera=found.X_parent_camera,
        X_parent_board=found.X_parent_board,
        intrinsics=plan.guess.intrinsics,
    )


def _deviation(views: Sequence[View], plan: Plan, guess: Estimate) -> float:
    if not views:
        return float("inf")
    return predicted_deviation(
        [view.X_base_tool for view in views],
        guess,
        plan.mounting,
        plan.target.corners(),
        plan.p_workspace,
        plan.pose_noise,
    )


def _enough(views: Sequence[View], plan: Plan) -> bool:
    return len(views) >= LEAST_VIEWS and _deviation(views, plan, plan.guess) <= plan.goal
