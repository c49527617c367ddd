"""After a protective stop a person looks, and then the arm is released. Nothing moves, and the
motion that was stopped is never gone on with."""

from __future__ import annotations

from contextlib import suppress

from rich.console import Console

from tdpg_deploy.cell import MachineClock
from tdpg_deploy.cell_config import ArmSection
from tdpg_deploy.drivers.ur5 import UrArm
from tdpg_deploy.drivers.ur5_network import ask_modes
from tdpg_deploy.drivers.ur5_status import SafetyMode
from tdpg_deploy.errors import DeviceError


def offer_recovery(console: Console, section: ArmSection) -> None:
    """Ask whether to release a protective stop, if the arm is in one, and do so after a yes."""
    if not _is_stopped(section.host):
        return
    console.print(
        "The arm is in a protective stop. Look at it: what did it meet? Take that out of its way, "
        "or leave the arm to somebody who knows it.",
        soft_wrap=True,
    )
    if console.input("Type yes to release it (nothing will move): ").strip().lower() != "yes":
        console.print("not released")
        return
    arm = UrArm(section, clock=MachineClock())
    try:
        with console.status("releasing: the controller allows it five seconds after the stop"):
            arm.recover()
    except DeviceError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
    else:
        console.print("released; tdpg-run drives straight up and home when it is started again")
    finally:
        arm.close()


def _is_stopped(host: str) -> bool:
    with suppress(DeviceError):  # what ails it has been told
        _, safety_mode = ask_modes(host)
        return safety_mode == SafetyMode.PROTECTIVE_STOP
    return False
