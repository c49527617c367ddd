"""Take views until the predicted error is small enough: by the arm's own motion, or by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from calibration.collection import (
    MOST_FAILURES,
    MOST_VIEWS,
    Collection,
    Devices,
    Plan,
    Progress,
    open_collection,
    take,
)
from calibration.poses import Hides, Reach
from calibration.views import Mounting
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform

SETTLE = 0.4  # s from the end of a motion to a picture; an arm with a board swings for less

OnProgress = Callable[[Progress], None]


class Mover(Protocol):
    """What moves the arm; see calibration.approach."""

    def reach(self, X_base_tool: Transform) -> Array | None: ...
    def hides(self, q: Array, eye: Array, points: Array) -> bool: ...
    def go(self, q: Array) -> None: ...
    def go_home(self) -> None: ...


def collect(
    devices: Devices,
    mover: Mover,
    plan: Plan,
    path: Path,
    rng: np.random.Generator,
    on_progress: OnProgress,
) -> None:
    """Move, look, choose again. Resumes `path` if it exists; ends with the arm at home, and with
    a look at the table when the camera is fixed.

    Raises CalibrationError when the goal is out of reach, with the views taken kept in `path`.
    """
    with open_collection(path, plan) as collection:
        while not collection.is_enough:
            _check_hope(collection, path)
            following = collection.propose(mover.reach, mover.hides, rng)
            if following is None:
                raise CalibrationError(
                    "no reachable pose shows the board: check the first guess of the camera's and "
                    "the board's pose"
                )
            on_progress(collection.progress(following))
            mover.go(following.q)
            devices.clock.sleep(SETTLE)
            collection.keep(take(devices, _name(collection)))
        on_progress(collection.progress(None))
        mover.go_home()
        if plan.setup.mounting is Mounting.EYE_TO_HAND:
            devices.clock.sleep(SETTLE)
            collection.keep_table(take(devices, "table"))


def collect_by_hand(
    devices: Devices,
    reach: Reach,
    hides: Hides,
    plan: Plan,
    path: Path,
    rng: np.random.Generator,
    on_progress: OnProgress,
    ask: Callable[[], bool],
) -> None:
    """Look each time that `ask` says so, until it says no: a person moves the arm in between.

    The arm is let go of meanwhile, so that its pendant and free drive can move it. Resumes `path`
    if it exists.
    """
    devices.arm.close()
    with open_collection(path, plan) as collection:
        while True:
            on_progress(collection.progress(collection.propose(reach, hides, rng)))
            if not ask():
                return
            devices.arm.connect()
            try:
                collection.keep(take(devices, _name(collection)))
            except CalibrationError as error:  # it moved: another try costs nothing
                collection.refuse(str(error))
            finally:
                devices.arm.close()


def _name(collection: Collection) -> str:
    return f"{len(collection.taken):03d}"


def _check_hope(collection: Collection, path: Path) -> None:
    if collection.failures >= MOST_FAILURES or len(collection.views) >= MOST_VIEWS:
        raise CalibrationError(
            f"{len(collection.views)} views give {collection.deviation * 1e3:.2f} mm, "
            f"{collection.failures} pictures could not be used: check light, board and first "
            f"guess; {path} keeps what was taken"
        )
