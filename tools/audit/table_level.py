"""Does the table still lie where the calibration has it? From one heightmap. Pure.

A camera that was tilted or lifted sees the table tilted or lifted; one that slid along the table
does not show here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from policies.heightmap import SIZE, Heightmap

STRIDE = 3  # pixels: 5,000 of the map are enough for a plane
FAR = 0.05  # m: the table is looked for so far around its place
BIN = 0.002  # m
THICKNESS = 0.006  # m around the plane that count as table
MIN_TABLE = 0.15  # share of the map that has to be table
MAX_LIFT = 0.006  # m; the D435's noise at a metre is 2 mm, and averages out
MAX_TILT = 0.010  # m from one side of the workspace to the other


@dataclass(frozen=True, kw_only=True)
class TableLevel:
    """lift: m, of the table's plane at the middle of the map. tilt: m that the plane rises across
    the map, along its steepest direction."""

    lift: float
    tilt: float

    @property
    def has_drifted(self) -> bool:
        return abs(self.lift) > MAX_LIFT or self.tilt > MAX_TILT


def table_level(heightmap: Heightmap) -> TableLevel | None:
    """None where too little of the table is seen."""
    seen = heightmap.height[::STRIDE, ::STRIDE]
    low = np.abs(np.nan_to_num(seen, nan=np.inf)) < FAR
    if low.mean() < MIN_TABLE:
        return None
    row, col = np.nonzero(low)
    height = seen[low].astype(np.float64)
    u, v = (index * STRIDE / (SIZE - 1) - 0.5 for index in (row, col))
    design = np.column_stack([np.ones_like(u), u, v])
    counts, edges = np.histogram(height, np.arange(-FAR, FAR + BIN, BIN))
    plane = np.array([edges[counts.argmax()] + BIN / 2, 0.0, 0.0])
    on_table = np.abs(height - design @ plane) < 2 * THICKNESS  # it may be tilted
    for _ in range(3):
        if on_table.sum() < MIN_TABLE * seen.size:
            return None
        plane = np.linalg.lstsq(design[on_table], height[on_table], rcond=None)[0]
        on_table = np.abs(height - design @ plane) < THICKNESS
    return TableLevel(lift=float(plane[0]), tilt=float(np.hypot(plane[1], plane[2])))
