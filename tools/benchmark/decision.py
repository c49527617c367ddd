"""How long a decision takes, from heightmap to primitive, on fresh weights.

The reference is the predecessors' way in the same run: the same network, one picture after the
other at batch 1, in float32, nothing folded.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from policies.heightmap import SIZE, Heightmap, Workspace
from policies.learned import LearnedPolicy
from policies.methods import METHODS
from policies.networks.build import WIDTHS, build
from policies.networks.maps import Network
from policies.policy import ROTATIONS
from policies.rotation import back_to_map, pictures
from policies.state import encode
from tools.benchmark.measure import Measurement, timed

NETWORKS = {  # width, repeats
    "light": (16, 20),
    "twin": (16, 20),
    "densenet121": (WIDTHS["densenet121"][0], 3),
}


def run() -> list[Measurement]:
    """Milliseconds a decision."""
    heightmap = cluttered_table(np.random.default_rng(0))
    results = []
    for kind, (width, repeats) in NETWORKS.items():
        torch.manual_seed(0)
        network = build(kind, goal=False, width=width).eval()
        reference = timed(
            f"{kind}: 16 pictures one by one, float32",
            lambda network=network: one_by_one(network, heightmap),  # type: ignore[misc]
            repeats=max(3, repeats // 4),
        )
        results.append(reference)
        for method in ("tdpg", "grasp-only"):
            for dtype in (torch.bfloat16, torch.float32):
                policy = LearnedPolicy(network, METHODS[method], goal=False, dtype=dtype)
                results.append(
                    timed(
                        f"{kind}: {method}, {str(dtype).removeprefix('torch.')}",
                        lambda policy=policy: policy.decide(  # type: ignore[misc]
                            dataclasses.replace(heightmap), np.random.default_rng(0)
                        ),
                        repeats=repeats,
                        reference=reference.median,
                    )
                )
    return results


@torch.inference_mode()
def one_by_one(network: Network, heightmap: Heightmap) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Both maps of each rotation."""
    whole = pictures(encode(heightmap, goal=False)).contiguous()
    maps = [network(whole[k : k + 1]) for k in range(ROTATIONS)]
    return [(back_to_map(one.push), back_to_map(one.grasp)) for one in maps]


def cluttered_table(rng: np.random.Generator) -> Heightmap:
    """Thirty upright blocks: what is on the table changes the time of masks only."""
    height = np.zeros((SIZE, SIZE), np.float32)
    for _ in range(30):
        row, col = rng.integers(5, SIZE - 30, 2)
        rows, cols = rng.integers(12, 26, 2)
        height[row : row + rows, col : col + cols] = rng.uniform(0.025, 0.06)
    return Heightmap(
        workspace=Workspace(x_min=0.276, y_min=-0.224, table_z=-0.15),
        color=rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8),
        height=height,
    )
