"""How Rerun lays out an episode: what is seen, how it is valued, what is measured."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from tdpg_deploy.episode_log import channels

TIMELINE = "message_publish_time"  # when it was measured, as Rerun's MCAP importer calls it
FORCE = "measured/force"
FINGERS = "measured/fingers"
TOLD = "told"


def build_blueprint() -> Any:
    """A rerun.blueprint.Blueprint. Needs rerun-sdk."""
    rrb: Any = import_module("rerun.blueprint")
    scene = rrb.Spatial3DView(
        name="cell",
        origin="/",
        contents=[channels.HEIGHTMAP_POINTS, channels.PLAN_POSES, channels.TRANSFORMS],
    )
    pictures = rrb.Grid(
        rrb.Spatial2DView(name="camera", origin=channels.COLOR),
        rrb.Spatial2DView(name="heightmap", origin=channels.HEIGHTMAP_COLOR),
        rrb.Spatial2DView(name="value of grasps", origin=channels.Q_GRASP),
        rrb.Spatial2DView(name="value of pushes", origin=channels.Q_PUSH),
        grid_columns=2,
    )
    measured = rrb.Horizontal(
        rrb.TimeSeriesView(name="force, N", origin=FORCE),
        rrb.TimeSeriesView(name="fingers, mm", origin=FINGERS),
        rrb.TextDocumentView(name="the step", origin=TOLD),
        rrb.TextLogView(name="log", origin=channels.LOG_LINES),
    )
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(scene, pictures), measured, row_shares=[3, 1]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )
