"""What people and cables do to a controller, by name: the commands of the emulator's control pipe.

A command is a JSON object {"do": name, ...arguments}; the answer is {"ok": result} or
{"error": text}.
"""

from __future__ import annotations

import inspect
from typing import Any

from tdpg_deploy.emulators.ur_controller.modes import RobotMode
from tdpg_deploy.emulators.ur_controller.server import Server


class Pendant:
    """Each public method is a command."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._controller = server.controller

    async def perform(self, command: dict[str, Any]) -> dict[str, Any]:
        """Do one command. The pipe's owner is trusted: any public method may be named."""
        arguments = dict(command)
        name = arguments.pop("do", "")
        if name.startswith("_") or name == "perform" or not hasattr(self, name):
            return {"error": f"no such command: {name!r}"}
        result = getattr(self, name)(**arguments)
        return {"ok": await result if inspect.isawaitable(result) else result}

    def truth(self) -> dict[str, Any]:
        """What is really so, whatever the network shows."""
        c = self._controller
        return {
            "time": c.time,
            "q": c.q.tolist(),
            "speed": float(abs(c.qd).max()),
            "force": c.force.tolist(),
            "tool": c.X_base_tool.as_rotation_vector().tolist(),
            "payload": c.payload,
            "runtime": c.runtime.name,
            "program": c.program_name,
            "safety": c.safety.name,
            "mode": c.mode.name,
        }

    # --- people -------------------------------------------------------------------------------

    def protective_stop(self) -> None:
        self._controller.protective_stop("made up by the pendant")

    def emergency_stop(self) -> None:
        self._controller.emergency_stop()

    def safeguard_stop(self) -> None:
        self._controller.safeguard_stop()

    def release_stop(self) -> None:
        self._controller.release_stop()

    def power_off(self) -> None:
        self._controller.power_off()

    def power_on(self) -> None:
        self._controller.power_on()
        self._controller.release_brakes()

    def local_control(self) -> None:
        self._controller.set_remote(False)

    def remote_control(self) -> None:
        self._controller.set_remote(True)

    def speed_slider(self, share: float) -> None:
        self._controller.slider = share

    def stop_program(self) -> None:
        self._controller.stop_program()

    def start_fieldbus(self) -> None:
        """A fieldbus adapter takes the input registers."""
        self._controller.claimed_by_fieldbus = frozenset(
            f"input_int_register_{i}" for i in range(24)
        )

    def stop_fieldbus(self) -> None:
        self._controller.claimed_by_fieldbus = frozenset()

    # --- cables -------------------------------------------------------------------------------

    def drop(self) -> None:
        self._server.drop()

    async def unplug(self) -> None:
        await self._server.unplug()

    async def plug_in(self) -> None:
        await self._server.listen()

    def freeze(self) -> None:
        self._server.freeze()

    def thaw(self) -> None:
        self._server.thaw()

    async def lose_power(self) -> None:
        """The controller goes down, clients are cut off; `plug_in` ends the boot."""
        await self._server.unplug()
        self._controller.reboot()

    async def reset(self) -> None:
        """All as it was at first, except for where the arm stands."""
        await self._server.unplug()
        self._server.thaw()
        self._controller.reboot(RobotMode.RUNNING)
        await self._server.listen()
