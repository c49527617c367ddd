"""A cell without physics for fast tests: the arm is where it was sent, boxes lie on a table, the
gripper holds what stands between its pads, a camera above sees the boxes' tops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tdpg_deploy.cell import Cell
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, Pose, load_cell
from tdpg_deploy.errors import ArmError, DeviceTimeout, GripperError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import (
    ArmState,
    GripperState,
    Holding,
    Intrinsics,
    MotionEnd,
    MotionResult,
    OnArmState,
    RgbdFrame,
)
from tdpg_deploy.kinematics import branch_of, forward, inverse_batch, nearest

STEP = 0.025  # s
CAMERA_HEIGHT = 1.0  # m above the table, looking straight down
INTRINSICS = Intrinsics(width=640, height=640, fx=1000.0, fy=1000.0, cx=319.5, cy=319.5)


@dataclass(frozen=True, kw_only=True)
class Box:
    """On the table, sides along the axes of base; the gripper may take it along either."""

    x: float
    y: float
    side: float = 0.05
    height: float = 0.05

    def covers(self, x: float, y: float) -> bool:
        return max(abs(x - self.x), abs(y - self.y)) <= self.side / 2


class Table:
    """The state of the world; `slippery` boxes never stay in the gripper."""

    def __init__(self, config: CellConfig, *boxes: Box, slippery: bool = False) -> None:
        self.config = config
        self.boxes = list(boxes)
        self.slippery = slippery
        self.held: Box | None = None
        self.time = 0.0
        self.q: Array = np.array(config.arm.home)
        self.width = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds

    @property
    def X_base_tool(self) -> Transform:
        arm = self.config.arm
        return forward(arm.dh, self.q, arm.X_flange_tool.transform())

    def top_at(self, x: float, y: float) -> float:
        """z in base of the highest thing there."""
        tops = [box.height for box in self.boxes if box.covers(x, y)]
        return self.config.workspace.table_z + max(tops, default=0.0)


class FakeArm:
    """`fail_in`: the motion, counted from 0, in which it raises `failure`. It sends states."""

    def __init__(
        self, table: Table, *, fail_in: int | None = None, failure: BaseException | None = None
    ) -> None:
        self.table = table
        self.fail_in = fail_in
        self.failure = failure or ArmError("made to fail")
        self.motions: list[str] = []
        self.stops = 0
        self.open = False
        self._halted = False

    def connect(self) -> None:
        self.open = True

    def close(self) -> None:
        self.open = False

    def state(self) -> ArmState:
        return ArmState(
            q=self.table.q,
            qd=np.zeros(6),
            X_base_tool=self.table.X_base_tool,
            force=np.zeros(3),
            stamp=self.table.now(),
        )

    def zero_force(self) -> None:
        self.motions.append("zero")

    def move_joints(
        self,
        q: Array,
        *,
        speed: float,
        acceleration: float,
        deadline: float,
        on_state: OnArmState | None = None,
    ) -> MotionResult:
        if np.abs(q).max() > 2 * np.pi:
            raise ArmError(f"joints {q} out of range")
        start = self.table.q
        count = _steps(float(np.abs(q - start).max()), speed)
        path = [start + share * (q - start) for share in np.linspace(0, 1, count + 1)[1:]]
        return self._run("joints", path, deadline, None, on_state)

    def move_linear(
        self,
        X_base_tool: Transform,
        *,
        speed: float,
        acceleration: float,
        deadline: float,
        stop_force: float | None = None,
        on_state: OnArmState | None = None,
    ) -> MotionResult:
        here = self.table.X_base_tool
        count = _steps(here.distance(X_base_tool)[0], speed)
        path = []
        dh, q = self.table.config.arm.dh, self.table.q
        branch = branch_of(dh, q)
        for share in np.linspace(0, 1, count + 1)[1:]:
            p = here.translation + share * (X_base_tool.translation - here.translation)
            flange = Transform(X_base_tool.rotation, p) @ self._X_tool_flange
            found = nearest(inverse_batch(dh, flange.as_matrix())[[branch]], q, (-6.3, 6.3))
            if found is None:
                raise ArmError(f"{p} is out of reach")
            q = found
            path.append(q)
        return self._run("linear", path, deadline, stop_force, on_state)

    @property
    def _X_tool_flange(self) -> Transform:
        return self.table.config.arm.X_flange_tool.transform().inverse()

    def stop(self) -> None:
        self.stops += 1
        self._halted = True

    def _run(
        self,
        name: str,
        path: list[Array],
        deadline: float,
        stop_force: float | None,
        on_state: OnArmState | None,
    ) -> MotionResult:
        number = len([motion for motion in self.motions if motion != "zero"])
        self.motions.append(name)
        if number == self.fail_in:
            raise self.failure
        self._halted = False
        arm, ends = self.table.config.arm, self.table.now() + deadline
        for q in path:
            lower = forward(arm.dh, q, arm.X_flange_tool.transform()).translation
            if stop_force is not None and self._touches(lower):
                return MotionResult(end=MotionEnd.CONTACT, state=self.state())
            self.table.q = q
            self.table.sleep(STEP)
            if on_state is not None:
                on_state(self.state())
            if self._halted:
                raise ArmError("stopped")
            if self.table.now() > ends:
                raise DeviceTimeout(f"not there after {deadline} s")
        return MotionResult(end=MotionEnd.REACHED, state=self.state())

    def _touches(self, p_base: Array) -> bool:
        """Finger tips against the table, and closed ones against boxes; only on the way down."""
        x, y, z = p_base
        if z >= self.table.X_base_tool.translation[2] - 1e-9:
            return False
        if self.table.width < 0.01:
            return bool(z < self.table.top_at(x, y))
        return bool(z < self.table.config.workspace.table_z)


class FakeGripper:
    max_width = 0.085

    def __init__(self, table: Table, *, failure: BaseException | None = None) -> None:
        self.table = table
        self.failure = failure
        self.active = False
        self.open = False

    def connect(self) -> None:
        self.open = True

    def close(self) -> None:
        self.open = False

    def activate(self, *, deadline: float = 10.0) -> None:
        self.active = True

    def state(self) -> GripperState:
        return GripperState(
            width=self.table.width,
            moving=False,
            holding=Holding.OBJECT if self.table.held else Holding.NOTHING,
            stamp=self.table.now(),
        )

    def move(
        self, width: float, *, speed: float, force: float, deadline: float = 5.0
    ) -> GripperState:
        if not self.active:
            raise GripperError("not activated")
        if self.failure is not None and width == 0.0:
            raise self.failure
        table = self.table
        x, y, z = table.X_base_tool.translation
        if width > table.width:
            table.held = None
        for box in list(table.boxes):
            between = box.covers(x, y) and box.side <= table.width and z < table.top_at(x, y)
            if width < box.side and between and not table.slippery:
                table.held, width = box, box.side
                table.boxes.remove(box)
        seconds = abs(width - table.width) / min(max(speed, 0.02), 0.15)
        if seconds > deadline:
            table.sleep(deadline)
            raise DeviceTimeout(f"fingers not there after {deadline} s")
        table.sleep(seconds)
        table.width = width
        return self.state()


class FakeCamera:
    """`blind`: sees nothing at all."""

    def __init__(self, table: Table, *, blind: bool = False) -> None:
        self.table = table
        self.blind = blind
        self.intrinsics = INTRINSICS
        self.open = False
        self._sequence = 0
        self.before_capture: Callable[[], None] = lambda: None

    def connect(self) -> None:
        self.open = True

    def close(self) -> None:
        self.open = False

    def capture(self, *, deadline: float = 2.0) -> RgbdFrame:
        self.before_capture()
        self._sequence += 1
        shape = (INTRINSICS.height, INTRINSICS.width)
        depth = np.full(shape, np.nan if self.blind else CAMERA_HEIGHT, np.float32)
        for box in self.table.boxes:
            X_camera_base = self.table.config.X_base_camera.inverse()
            half = box.side / 2
            top = self.table.config.workspace.table_z + box.height
            corners = np.array(
                [[box.x + dx, box.y + dy, top] for dx in (-half, half) for dy in (-half, half)]
            )
            p = X_camera_base @ corners
            u = p[:, 0] / p[:, 2] * INTRINSICS.fx + INTRINSICS.cx
            v = p[:, 1] / p[:, 2] * INTRINSICS.fy + INTRINSICS.cy
            rows = slice(max(0, round(v.min())), max(0, round(v.max())))
            cols = slice(max(0, round(u.min())), max(0, round(u.max())))
            depth[rows, cols] = p[0, 2]
        return RgbdFrame(
            color=np.full((*shape, 3), 128, np.uint8),
            depth=depth,
            intrinsics=INTRINSICS,
            captured_at=self.table.now(),
            sequence=self._sequence,
            serial="fake",
        )


def kinematic_config() -> CellConfig:
    """The mock cell with the camera straight above the workspace."""
    config = load_cell(DEFAULT_CELL)
    x, y = config.workspace.center
    above = Pose(
        position=(x, y, config.workspace.table_z + CAMERA_HEIGHT), quaternion=(1.0, 0.0, 0.0, 0.0)
    )
    return config.model_copy(
        update={"camera": config.camera.model_copy(update={"X_base_camera": above})}
    )


def kinematic_cell(table: Table, **devices: object) -> Cell:
    """`devices` replace arm, gripper or camera."""
    parts = {
        "camera": FakeCamera(table),
        "arm": FakeArm(table),
        "gripper": FakeGripper(table),
    } | devices
    return Cell(config=table.config, clock=table, **parts)  # type: ignore[arg-type]


def _steps(way: float, speed: float) -> int:
    return max(1, int(np.ceil(way / speed / STEP)))
