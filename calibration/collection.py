"""Views as they are gathered: kept in a record, judged, and followed by the best next pose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Protocol

import numpy as np

from calibration.coverage import Coverage, coverage
from calibration.detect import detect
from calibration.poses import Candidate, Hides, Reach, best_next, candidates, predicted_deviation
from calibration.projection import Estimate
from calibration.record import RecordedView, RecordWriter, Setup, read_record
from calibration.refine import Freedom
from calibration.solve import solve
from calibration.target import CharucoTarget
from calibration.views import Mounting, PoseNoise, View
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Arm, Camera, Clock, Intrinsics

LEAST_VIEWS, MOST_VIEWS, MOST_FAILURES = 10, 25, 12
FIRST_SOLUTION = 6  # views from which both poses are solved anew after each
TOOL_DEPTHS = (0.4, 0.6)  # m before a camera on the tool
STILL = 0.2e-3  # m that the tool may move during a picture


class Devices(Protocol):
    """What is needed of a cell."""

    @property
    def camera(self) -> Camera: ...
    @property
    def arm(self) -> Arm: ...
    @property
    def clock(self) -> Clock: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """What is to be found, and from where.

    guess: both poses within some centimetres and degrees. goal: metres, root mean variance of
    points of the workspace. p_workspace: (n, 3) in the camera's parent frame.
    """

    setup: Setup
    guess: Estimate
    p_workspace: Array
    goal: float = 0.1e-3
    pose_noise: PoseNoise = field(default_factory=PoseNoise)

    @property
    def target(self) -> CharucoTarget:
        return self.setup.target


@dataclass(frozen=True, kw_only=True, eq=False)
class Progress:
    """Where a collection stands.

    views: those that count. deviation: predicted (m). last: the picture just taken, None at the
    start; problems: why it does not count. X_camera_board: where the board is best shown next.
    """

    views: tuple[View, ...]
    deviation: float
    coverage: Coverage
    last: RecordedView | None
    problems: tuple[str, ...]
    X_camera_board: Transform | None


def wanted_points(setup: Setup, X_parent_camera: Transform, lens: Intrinsics) -> Array:
    """(n, 3) in the camera's parent frame: where the calibration is to be good.

    That is over the workspace, or in the view of a camera on the tool.
    """
    if setup.mounting is Mounting.EYE_TO_HAND:
        square = setup.workspace
        x, y = np.linspace(*square.x_range, 5), np.linspace(*square.y_range, 5)
        heights = [square.table_z, square.table_z + 0.1]
        return np.stack(np.meshgrid(x, y, heights), axis=-1).reshape(-1, 3)
    u, v, z = np.meshgrid(
        np.linspace(0.1, 0.9, 5) * lens.width, np.linspace(0.1, 0.9, 5) * lens.height, TOOL_DEPTHS
    )
    rays = [(u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy, np.ones_like(u)]
    p_camera: Array = (z[..., None] * np.stack(rays, axis=-1)).reshape(-1, 3)
    return X_parent_camera @ p_camera


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


@contextmanager
def open_collection(path: Path, plan: Plan) -> Iterator[Collection]:
    """A collection that goes on where `path` ends, if it exists. Raises CalibrationError."""
    earlier = read_record(path) if path.exists() else None
    if earlier is not None and earlier.setup != plan.setup:
        raise CalibrationError(
            f"{path} was begun with another board, mounting or workspace: "
            "give the same, or another --record"
        )
    partial = path.with_name(path.name + ".partial")
    date = datetime.now(timezone.utc) if earlier is None else earlier.date
    with RecordWriter(partial, plan.setup, date) as writer:
        collection = Collection(plan, writer)
        for recorded in [] if earlier is None else earlier.views:
            collection.keep(recorded)
        # The file grows under its own name from here on, so that it can be resumed.
        partial.replace(path)
        yield collection


class Collection:
    """Views so far. taken: all pictures; views: those that count."""

    def __init__(self, plan: Plan, writer: RecordWriter) -> None:
        self.plan = plan
        self.taken: list[RecordedView] = []
        self.views: list[View] = []
        self._writer = writer
        self._problems: tuple[str, ...] = ()
        self._guess = plan.guess

    def keep(self, recorded: RecordedView) -> None:
        self._writer.add(recorded)
        self.taken.append(recorded)
        view, self._problems = view_of(recorded, self.plan.target)
        if view is not None:
            self.views.append(view)
            self._guess = refined_guess(self.views, self.plan)

    def keep_table(self, recorded: RecordedView) -> None:
        self._writer.add_table(recorded)

    @property
    def failures(self) -> int:
        return len(self.taken) - len(self.views)

    @property
    def deviation(self) -> float:
        """Predicted, metres, root mean variance over the workspace."""
        if not self.views:
            return float("inf")
        plan = self.plan
        return predicted_deviation(
            [view.X_base_tool for view in self.views],
            self._guess,
            plan.setup.mounting,
            plan.target.corners(),
            plan.p_workspace,
            plan.pose_noise,
        )

    @property
    def is_enough(self) -> bool:
        return len(self.views) >= LEAST_VIEWS and self.deviation <= self.plan.goal

    def propose(self, reach: Reach, hides: Hides, rng: np.random.Generator) -> Candidate | None:
        """Of poses that `reach` lets through, and that show the board, the one that lowers the
        predicted error most; None when there is none."""
        plan, corners = self.plan, self.plan.target.corners()
        mounting, table_z = plan.setup.mounting, plan.setup.workspace.table_z
        offered = candidates(self._guess, mounting, corners, reach, hides, table_z, rng)
        if not offered:
            return None
        choice = best_next(
            [candidate.X_base_tool for candidate in offered],
            [view.X_base_tool for view in self.views],
            self._guess,
            mounting,
            corners,
            plan.p_workspace,
            plan.pose_noise,
        )
        return offered[choice.index]

    def refuse(self, problem: str) -> None:
        """A picture could not even be taken."""
        self._problems = (problem,)

    def progress(self, following: Candidate | None) -> Progress:
        lens = self._guess.intrinsics
        return Progress(
            views=tuple(self.views),
            deviation=self.deviation,
            coverage=coverage(self.views, self.plan.target.corners(), lens),
            last=self.taken[-1] if self.taken else None,
            problems=self._problems,
            X_camera_board=None if following is None else following.X_camera_board,
        )


def refined_guess(views: list[View], plan: Plan) -> Estimate:
    """Solved from the views so far once they suffice, else the first guess."""
    if len(views) < FIRST_SOLUTION:
        return plan.guess
    corners, lens, mounting = plan.target.corners(), plan.guess.intrinsics, plan.setup.mounting
    try:
        found = solve(views, corners, lens, mounting, freedoms=[Freedom()])
    except CalibrationError:
        return plan.guess
    return Estimate(
        X_parent_camera=found.X_parent_camera,
        X_parent_board=found.X_parent_board,
        intrinsics=lens,
    )
