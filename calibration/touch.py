"""The touch test: does the tool meet things at the height at which the camera sees them?

It tests everything at once: the camera's pose, its depth, the arm's kinematics and the tool's
length. Five to nine flat things lie on the table (blocks will do); the closed fingers come down
on each, slowly, until they feel it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, median_filter, minimum_filter

from tdpg_deploy import kinematics
from tdpg_deploy.cell_config import CellConfig
from tdpg_deploy.errors import CalibrationError, PlanRefused
from tdpg_deploy.geometry import Array, Transform, top_down
from tdpg_deploy.hal import Arm, Gripper, MotionEnd
from tdpg_deploy.plan import MoveFingers, MoveJoints, MoveLinear, Step
from tdpg_deploy.safety import check_steps

FEWEST, MOST = 5, 9
PIXEL = 0.005  # m of the map that places are looked for in
PATCH = 7  # pixels across that have to be flat: closed finger tips are 22 by 36 mm
FLAT = 0.006  # m from lowest to highest in a patch; depth noise at 0.8 m takes most of it
RISE = 0.010  # m above the table: the check lets nothing go lower than its clearance
APART = 0.04  # m between two places
MARGIN = 0.015  # m before the surface seen to slow down, and beyond it to give up
TOUCH_SPEED, CLOSED_SPEED = 0.01, 0.05  # m/s
DEADLINE = 60.0  # s


@dataclass(frozen=True, kw_only=True, eq=False)
class Touch:
    """p_seen: (3,) in base by the camera, m. height: z in base where the tool felt it; nan when it
    felt nothing down to MARGIN below."""

    p_seen: Array
    height: float

    @property
    def error(self) -> float:
        """Metres that the tool met it above where it was seen."""
        return float(self.height - self.p_seen[2])


def find_places(p_base: Array, config: CellConfig) -> list[Array]:
    """Up to MOST flat raised places, far from each other, among points (n, 3) seen in base.

    Raises CalibrationError when they are fewer than FEWEST.
    """
    square = config.workspace
    low = np.array([square.x_range[0], square.y_range[0]])
    cells = np.floor((p_base[:, :2] - low) / PIXEL).astype(int)
    size = int(np.ceil((square.x_range[1] - low[0]) / PIXEL))
    inside = ((cells >= 0) & (cells < size)).all(axis=1)
    highest, lowest = np.full((size, size), -np.inf), np.full((size, size), np.inf)
    np.maximum.at(highest, tuple(cells[inside].T), p_base[inside, 2])
    np.minimum.at(lowest, tuple(cells[inside].T), p_base[inside, 2])
    # What is not seen is neither flat nor high enough.
    flat = maximum_filter(highest, PATCH) - minimum_filter(lowest, PATCH) < FLAT
    known = np.isfinite(highest)
    seen = minimum_filter(known.astype(int), PATCH) == 1
    middle = np.zeros_like(highest)
    middle[known] = (highest[known] + lowest[known]) / 2
    height = median_filter(middle, PATCH)
    rows, cols = np.nonzero(flat & seen & (height > square.table_z + RISE))
    offered = np.column_stack(
        [low + (np.stack([rows, cols], axis=1) + 0.5) * PIXEL, height[rows, cols]]
    )
    places = _spread(offered)
    if len(places) < FEWEST:
        raise CalibrationError(
            f"{len(places)} flat places 10 mm or more above the table are seen, {FEWEST} are "
            "needed: lay blocks or books on it, some 40 mm apart"
        )
    return places


def _spread(offered: Array) -> list[Array]:
    """Greedily those farthest from all taken."""
    if not len(offered):
        return []
    middle = offered[:, :2].mean(axis=0)
    taken = [int(np.linalg.norm(offered[:, :2] - middle, axis=1).argmax())]
    distance = np.full(len(offered), np.inf)
    while len(taken) < MOST:
        last = offered[taken[-1], :2]
        distance = np.minimum(distance, np.linalg.norm(offered[:, :2] - last, axis=1))
        if distance.max() < APART:
            break
        taken.append(int(distance.argmax()))
    return [offered[i] for i in taken]


def plan_touch(place: Array, config: CellConfig) -> tuple[Step, ...]:
    """Close, above, down to before the surface, slowly on, up, home. place: (3,) in base, m.

    It has passed the check of every motion. Raises PlanRefused.
    """
    limits, home = config.limits, np.array(config.arm.home)
    x, y, z = place
    floor = config.workspace.table_z + limits.table_clearance
    travel = config.workspace.table_z + limits.travel_height
    refusal: PlanRefused | None = None
    for yaw in np.deg2rad([0.0, 90.0, 180.0, -90.0]):
        above = top_down(x, y, travel, yaw)
        branches = kinematics.inverse(config.arm.dh, above, config.arm.X_flange_tool.transform())
        q_above = kinematics.nearest(branches, home, limits.joint_range)
        if q_above is None:
            continue
        before, beyond = (top_down(x, y, max(z + away, floor), yaw) for away in (MARGIN, -MARGIN))
        steps = (
            MoveFingers(name="close", width=0.0, speed=CLOSED_SPEED, force=config.gripper.force),
            _joints("above", q_above, config),
            _guarded("lower", before, limits.contact_speed, config),
            _guarded("touch", beyond, min(TOUCH_SPEED, limits.contact_speed), config),
            _guarded("lift", above, limits.contact_speed, config),
            _joints("home", home, config),
        )
        try:
            check_steps(steps, home, config)
        except PlanRefused as error:
            refusal = error
        else:
            return steps
    raise refusal or PlanRefused(f"({x:.3f}, {y:.3f}, {z:.3f}) m is out of the arm's reach")


def touch(place: Array, arm: Arm, gripper: Gripper, config: CellConfig) -> Touch:
    """Do it, the arm being at home. Raises PlanRefused before anything moves, or DeviceError."""
    height = float("nan")
    for step in plan_touch(place, config):
        if isinstance(step, MoveFingers):
            gripper.move(step.width, speed=step.speed, force=step.force)
        elif isinstance(step, MoveJoints):
            arm.move_joints(
                step.q, speed=step.speed, acceleration=step.acceleration, deadline=DEADLINE
            )
            arm.zero_force()
        else:
            result = arm.move_linear(
                step.X_base_tool,
                speed=step.speed,
                acceleration=step.acceleration,
                deadline=DEADLINE,
                stop_force=step.stop_force,
            )
            if result.end is MotionEnd.CONTACT and step.name == "touch":
                height = float(result.state.X_base_tool.translation[2])
    return Touch(p_seen=place, height=height)


def touch_all(
    places: Sequence[Array],
    arm: Arm,
    gripper: Gripper,
    config: CellConfig,
    on_touch: Callable[[Touch], None],
) -> list[Touch]:
    """Each place that the check lets through. Raises CalibrationError when those are too few."""
    touches: list[Touch] = []
    refused: list[str] = []
    for place in places:
        try:
            touches.append(touch(place, arm, gripper, config))
        except PlanRefused as error:
            refused.append(str(error))
            continue
        on_touch(touches[-1])
    if len(touches) < FEWEST:
        raise CalibrationError(
            f"{len(touches)} places could be touched, {FEWEST} are needed: {'; '.join(refused)}"
        )
    return touches


def _joints(name: str, q: Array, config: CellConfig) -> MoveJoints:
    limits = config.limits
    return MoveJoints(
        name=name, q=q, speed=limits.joint_speed / 2, acceleration=limits.joint_acceleration / 2
    )


def _guarded(name: str, X_base_tool: Transform, speed: float, config: CellConfig) -> MoveLinear:
    limits = config.limits
    return MoveLinear(
        name=name,
        X_base_tool=X_base_tool,
        speed=speed,
        acceleration=limits.acceleration,
        stop_force=limits.descend_force,
    )
