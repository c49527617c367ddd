"""A tdpg-emulate of its own for tests, and a policy that sees and grasps the same every time."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from ur_rig import new_host, processes_of, wait_until

from policies.decide import best_grasps, decided
from policies.errors import NoActionError
from policies.heightmap import SIZE, Heightmap
from policies.masks import allowed
from policies.policy import ROTATIONS, Decision, QMaps
from policies.primitives import Primitive
from tdpg_deploy.cell_config import DEFAULT_CELL, CellConfig, load_cell
from tdpg_deploy.emulators.cell_file import CAMERA_PORT
from tdpg_deploy.emulators.cell_process import CellProcess

PORTS = (29999, 30003, 30004, 63352, 54321, CAMERA_PORT)
# rad/s; of itself Bullet's arm trembles by up to 0.004 where it stands, and gets nowhere
STILL = 0.01

SCENE_HEAD = 'version = 1\nframe = "base"\nlength = "m"\nquaternion = "xyzw"\n'


def cubes(directory: Path, *places: tuple[float, float]) -> Path:
    """A scene file of 50 mm cubes that stand at these places (x, y) of the table, m."""
    file = directory / "scene.toml"
    objects = [
        f'[[object]]\nshape = "cube"\nposition = [{x}, {y}, -0.125]\n'
        "quaternion = [0.0, 0.0, 0.0, 1.0]\nrgb = [225, 87, 89]\n"
        for x, y in places
    ]
    file.write_text(SCENE_HEAD + "".join(objects))
    return file


def small_cell(**gripper: object) -> CellConfig:
    """The mock cell on an address of its own, with a camera that costs little to draw and whose
    pictures may be late."""
    config = load_cell(DEFAULT_CELL)
    camera = {"width": 640, "fps": 6, "max_frame_age": 2.0}
    return config.model_copy(
        update={
            "arm": config.arm.model_copy(update={"host": new_host()}),
            "camera": config.camera.model_copy(update=camera),
            "gripper": config.gripper.model_copy(update=gripper),
            "simulation": config.simulation.model_copy(update={"depth_noise": False}),
        }
    )


class EmulatorRig(CellProcess):
    """A running tdpg-emulate, and waits for what its arm does."""

    @property
    def host(self) -> str:
        return self.config.arm.host

    def kill(self) -> None:
        """It dies with all its devices at once."""
        self._process.kill()

    def wait_for_motion(self, *, deadline: float = 60.0) -> None:
        wait_until(lambda: self.do("truth")["speed"] > 0.2, deadline=deadline)

    def wait_for_rest(self, *, deadline: float = 20.0) -> None:
        truth: dict[str, Any] = {}

        def rests() -> bool:
            truth.update(self.do("truth"))
            return bool(truth["speed"] < STILL)

        try:
            wait_until(rests, deadline=deadline)
        except AssertionError:
            raise AssertionError(f"the arm does not come to rest: {truth}") from None

    def stands_still(self) -> bool:
        """For a second of the cell's time."""
        before = self.do("truth")
        wait_until(lambda: self.do("truth")["time"] > before["time"] + 1.0, deadline=60.0)
        return bool(np.abs(np.subtract(self.do("truth")["q"], before["q"])).max() < 1e-3)


@contextmanager
def emulator(config: CellConfig, *arguments: str | Path) -> Iterator[EmulatorRig]:
    """A running tdpg-emulate, of which nothing is left afterwards."""
    rig = EmulatorRig(config, *arguments)
    with rig:
        yield rig
    assert rig.exit_code == 0
    assert processes_of(config.arm.host) == {}
    for port in PORTS:
        with socket.socket() as probe:
            assert probe.connect_ex((config.arm.host, port)) != 0, f"{port} still listens"


class TallestGrasp:
    """Grasps where the table is highest, the fingers along one axis if they may."""

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        height = gaussian_filter(np.nan_to_num(heightmap.height), 4.0)
        preference = -1e-3 * np.arange(ROTATIONS)[:, None, None]
        maps = QMaps(
            grasp=(height + preference).astype(np.float32),
            push=np.full((ROTATIONS, SIZE, SIZE), -np.inf, np.float32),
        )
        grasps = best_grasps(allowed(maps, heightmap, avoid), rng, count=1)
        if not grasps:
            raise NoActionError("nothing to grasp")
        (grasp,) = grasps
        return decided(grasp, heightmap, maps, seconds={})
