"""Tags on the simulated table, found where they were laid, and in nobody's way."""

from __future__ import annotations

import cv2
import numpy as np

from calibration.drift import find_tags
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.sim.camera import COLOR_1280
from tdpg_deploy.workspace import workspace_of

MOCK = load_cell(DEFAULT_CELL)
TAGGED = MOCK.model_copy(
    update={"simulation": MOCK.simulation.model_copy(update={"table_tags": True})}
)


def test_each_tag_is_seen_face_up_at_its_place() -> None:
    """Corners by OpenCV's projection: clockwise from the upper left, as seen from above, the
    arm's side left, so that x is up and y is left in the picture from behind the table."""
    with open_cell(TAGGED) as cell:
        found = find_tags(cell.camera.capture().color).corners
    X = MOCK.X_base_camera.inverse()
    places = [(0.35, -0.287), (0.35, 0.287), (0.65, -0.287), (0.65, 0.287)]
    around = 0.025 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    assert sorted(found) == [0, 1, 2, 3]
    for number, place in enumerate(places):
        corners = np.column_stack([around + place, np.full(4, -0.15 + 0.3e-3)])
        pixels, _ = cv2.projectPoints(
            corners, X.rotation.as_rotvec(), X.translation, COLOR_1280.as_matrix(), None
        )
        np.testing.assert_allclose(found[number], pixels[:, 0], atol=1.0)  # px: edges are hard


def test_no_tag_reaches_into_the_workspace() -> None:
    with open_cell(MOCK) as bare, open_cell(TAGGED) as tagged:
        frames = [cell.camera.capture() for cell in (bare, tagged)]
    changed = (frames[0].color != frames[1].color).any(axis=2)
    rows, columns = np.nonzero(changed)
    workspace = workspace_of(MOCK)
    lens = COLOR_1280
    rays = np.stack([(columns - lens.cx) / lens.fx, (rows - lens.cy) / lens.fy], axis=1)
    R, eye = MOCK.X_base_camera.rotation, MOCK.X_base_camera.translation
    towards = R.apply(np.pad(rays, ((0, 0), (0, 1)), constant_values=1.0))
    p_table = eye + towards * ((workspace.table_z - eye[2]) / towards[:, 2])[:, None]
    assert len(p_table) > 4 * 50 * 50
    assert not any(workspace.contains(x, y, margin=-0.02) for x, y, _ in p_table)
