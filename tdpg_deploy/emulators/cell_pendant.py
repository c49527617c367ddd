"""What people, cables and wear do to a whole emulated cell, by name."""

from __future__ import annotations

import inspect
import json
from typing import Any

from tdpg_deploy.emulators.cell import EmulatedCell
from tdpg_deploy.emulators.robotiq import FaultCode
from tdpg_deploy.emulators.robotiq_wires import clean, mute
from tdpg_deploy.emulators.ur_controller.pendant import Pendant
from tdpg_deploy.sim.world import Where


class CellPendant(Pendant):
    """The arm's commands, and those of gripper and camera."""

    def __init__(self, cell: EmulatedCell) -> None:
        super().__init__(cell.arm)
        self._cell = cell

    async def obey(self, line: str) -> dict[str, Any]:
        """A command as a person types it: `speed_slider share=0.5`."""
        name, *pairs = line.split()
        if name not in self.commands():
            return {"error": f"no such command: {name}; there are {', '.join(self.commands())}"}
        takes = inspect.signature(getattr(self, name))
        try:
            given = (pair.partition("=") for pair in pairs)
            arguments = {key: json.loads(value) for key, _, value in given}
            takes.bind(**arguments)
        except (ValueError, TypeError) as error:
            return {
                "error": f"{name}: {error}; it takes {', '.join(takes.parameters) or 'nothing'}"
            }
        return await self.perform({"do": name, **arguments})

    @classmethod
    def commands(cls) -> list[str]:
        names = (name for name, _ in inspect.getmembers(cls, inspect.isfunction))
        return [n for n in names if not n.startswith("_") and n not in ("obey", "perform")]

    def objects(self) -> dict[str, int]:
        """How many lie where."""
        places = [state.where for state in self._cell.world.objects()]
        return {where.value: places.count(where) for where in Where}

    # --- gripper ------------------------------------------------------------------------------

    def gripper_mute(self) -> None:
        """Its answers do not arrive any more."""
        self._cell.gripper.line = mute

    def gripper_speak(self) -> None:
        self._cell.gripper.line = clean

    def gripper_fault(self, code: int) -> None:
        """gFLT, as 10 for under-voltage."""
        self._cell.gripper.model.fail(FaultCode(code))

    def gripper_lose_power(self) -> None:
        self._cell.gripper.model.cut_power()

    def gripper_restore_power(self) -> None:
        self._cell.gripper.model.restore_power()

    # --- camera -------------------------------------------------------------------------------

    def camera_stall(self) -> None:
        """No frame comes any more."""
        self._cell.camera.stall()

    def camera_freeze(self) -> None:
        """The same picture comes for ever, and grows old."""
        self._cell.camera.freeze()

    def camera_tear(self, seconds: float) -> None:
        """Colour comes so much later than the depth of its pair."""
        self._cell.camera.tear(seconds)

    def camera_holes(self, share: float) -> None:
        """The left share of the picture has no depth."""
        self._cell.camera.blind(share)

    async def camera_unplug(self) -> None:
        await self._cell.camera.unplug()

    async def camera_plug_in(self) -> None:
        assert self._cell.config.camera.emulated is not None
        await self._cell.camera.listen(*self._cell.config.camera.emulated)

    def camera_resume(self) -> None:
        self._cell.camera.resume()
