"""Cells that are simulated by the thousand."""

from __future__ import annotations

from tdpg_deploy.cell_config import CellConfig


def in_a_hurry(cell: CellConfig) -> CellConfig:
    """The same cell with a gantry in place of the arm, fast, and the smaller picture."""
    hurry = {
        "travel_speed": 1.0,
        "contact_speed": 0.25,
        "touch_speed": 0.25,
        "acceleration": 5.0,
        "joint_speed": 3.1,
        "joint_acceleration": 10.0,
    }
    return cell.model_copy(
        update={
            "camera": cell.camera.model_copy(update={"width": 640}),
            "simulation": cell.simulation.model_copy(update={"carrier": "gantry"}),
            "limits": cell.limits.model_copy(update=hurry),
        }
    )
