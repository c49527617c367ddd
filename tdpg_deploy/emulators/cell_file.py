"""The cell file of an emulated cell: what it takes over, and what it has to say itself."""

from __future__ import annotations

import ipaddress
import json
from typing import Any

from tdpg_deploy.cell_config import CellConfig, GripperSection
from tdpg_deploy.drivers.robotiq_rtu import TUNNEL_PORT
from tdpg_deploy.drivers.robotiq_urcap import URCAP_PORT
from tdpg_deploy.emulators.robotiq import CLOSED_COUNTS, OPEN_COUNTS
from tdpg_deploy.emulators.robotiq_wires import UNIT_ID, RobotiqEmulator

CAMERA_PORT = 30435
LOCALHOST = "127.0.0.1"


def emulated(config: CellConfig) -> CellConfig:
    """The cell of `config` on this machine: at its own address where that is a loopback address,
    else at 127.0.0.1; with the emulated gripper's counts and the simulated arm."""
    host = config.arm.host if _is_loopback(config.arm.host) else LOCALHOST
    return config.model_copy(
        update={
            "arm": config.arm.model_copy(update={"host": host}),
            "camera": config.camera.model_copy(
                update={"emulated": (host, CAMERA_PORT), "recording": None}
            ),
            "gripper": config.gripper.model_copy(
                update={
                    "host": host,
                    "unit_id": UNIT_ID,
                    "open_counts": OPEN_COUNTS,
                    "closed_counts": CLOSED_COUNTS,
                }
            ),
            "simulation": config.simulation.model_copy(update={"carrier": "arm"}),
        }
    )


def serve_gripper(emulator: RobotiqEmulator, section: GripperSection) -> GripperSection:
    """Open the wire that the cell file asks for; the section to reach it by."""
    assert section.host is not None
    if section.driver == "robotiq_rtu":
        return section.model_copy(update={"port": emulator.serve_pty()})
    if section.driver == "robotiq_rtu_tcp":
        serve, usual = emulator.serve_rtu_over_tcp, TUNNEL_PORT
    else:
        serve, usual = emulator.serve_urcap, URCAP_PORT
    _, port = serve(section.host, section.tcp_port or usual)
    return section.model_copy(update={"tcp_port": port})


def format_cell(config: CellConfig) -> str:
    """As TOML that loads to the same cell."""
    data = config.model_dump(mode="json", exclude_defaults=True)
    top = {key: value for key, value in data.items() if not isinstance(value, dict)}
    blocks = [_lines(top)]
    for name, section in data.items():
        if isinstance(section, dict):
            blocks.append([f"[{name}]", *_lines(section)])
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def _lines(section: dict[str, Any]) -> list[str]:
    return [f"{key} = {_value(value)}" for key, value in section.items()]


def _value(value: Any) -> str:
    """Numbers, strings and booleans are written as in JSON; tables in one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(_lines(value)) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value)


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a name
        return False
