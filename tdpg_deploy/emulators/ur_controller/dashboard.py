"""The dashboard server's commands: one line in, one line out. No sockets.

Source: Universal Robots, "Dashboard Server CB-series / e-Series, port 29999".
"""

from __future__ import annotations

from collections.abc import Callable

from tdpg_deploy.emulators.ur_controller.controller import Controller, Refused
from tdpg_deploy.emulators.ur_controller.modes import RuntimeState

GREETING = "Connected: Universal Robots Dashboard Server"
NOT_REMOTE = "Not allowed: the robot is not in remote control"


def _do(action: Callable[[Controller], None], reply: str) -> Callable[[Controller], str]:
    """Needs remote control; replies why when the controller refuses."""

    def answer(c: Controller) -> str:
        if c.generation.has_remote_control and not c.remote:
            return NOT_REMOTE
        try:
            action(c)
        except Refused as refusal:
            return str(refusal)
        return reply

    return answer


def _version(c: Controller) -> str:
    return "URSoftware " + ".".join(map(str, c.generation.version)) + " (Dec 17 2021)"


_COMMANDS: dict[str, Callable[[Controller], str]] = {
    "polyscopeversion": _version,
    "get robot model": lambda _: "UR5",
    "robotmode": lambda c: f"Robotmode: {c.mode.name}",
    "safetymode": lambda c: f"Safetymode: {c.safety.name}",
    "safetystatus": lambda c: f"Safetystatus: {c.safety.name}",
    "programstate": lambda c: f"{c.runtime.name} {c.program_name}",
    "running": lambda c: f"Program running: {str(c.runtime is RuntimeState.PLAYING).lower()}",
    "stop": _do(Controller.stop_program, "Stopped"),
    "pause": _do(Controller.pause_program, "Pausing program"),
    "play": _do(Controller.play, "Starting program"),
    "unlock protective stop": _do(Controller.unlock_protective_stop, "Protective stop releasing"),
    "power on": _do(Controller.power_on, "Powering on"),
    "power off": _do(Controller.power_off, "Powering off"),
    "brake release": _do(Controller.release_brakes, "Brake releasing"),
    "close safety popup": lambda _: "closing safety popup",
    "close popup": lambda _: "closing popup",
    "quit": lambda _: "Disconnected",
}
_WITH_REMOTE_CONTROL: dict[str, Callable[[Controller], str]] = {
    "get serial number": lambda _: "20195500001",
    "is in remote control": lambda c: str(c.remote).lower(),
}


def answer(line: str, controller: Controller) -> str:
    """The reply to one command, without newline."""
    command = line.strip().lower()
    found = _COMMANDS.get(command)
    if found is None and controller.generation.has_remote_control:
        found = _WITH_REMOTE_CONTROL.get(command)
    return found(controller) if found else f'could not understand: "{line.strip()}"'
