"""Load a dataset by the lerobot package itself, and print as JSON what it finds.

    python load_by_lerobot.py FOLDER

Where torchvision is missing or broken, the two of its names that loading needs are put in its
place: lerobot imports it for videos and for PIL pictures that become tensors.
"""

from __future__ import annotations

import importlib.machinery
import json
import sys
import types


def stand_in_for_torchvision() -> None:
    import numpy as np
    import torch

    class ToTensor:
        """(H, W, C) uint8 PIL picture -> (C, H, W) float32 in [0, 1], as torchvision documents."""

        def __call__(self, picture: object) -> torch.Tensor:
            return torch.from_numpy(np.array(picture)).permute(2, 0, 1).float() / 255

    root = types.ModuleType("torchvision")
    root.__spec__ = importlib.machinery.ModuleSpec("torchvision", None)
    transforms = types.ModuleType("torchvision.transforms")
    vars(root)["transforms"] = transforms
    vars(transforms)["ToTensor"] = ToTensor
    sys.modules |= {"torchvision": root, "torchvision.transforms": transforms}


def load(folder: str) -> dict[str, object]:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # type: ignore[import-not-found]

    whole = LeRobotDataset("local/tdpg", root=folder)
    last = LeRobotDataset("local/tdpg", root=folder, episodes=[whole.num_episodes - 1])
    pairs = LeRobotDataset("local/tdpg", root=folder, delta_timestamps={"action": [0.0, 1.0]})
    items = [whole[i] for i in range(len(whole))]
    pictures = {key: whole.meta.shapes[key] for key in whole.meta.camera_keys}
    return {
        "frames": len(whole),
        "episodes": whole.num_episodes,
        "fps": whole.fps,
        "pictures": {key: list(shape) for key, shape in pictures.items()},
        "tensors": {key: list(items[0][key].shape) for key in pictures},
        "means": {key: [float(item[key].mean()) for item in items] for key in pictures},
        "action": [item["action"].tolist() for item in items],
        "state": [item["observation.state"].tolist() for item in items],
        "reward": [item["next.reward"].item() for item in items],
        "done": [item["next.done"].item() for item in items],
        "task": [item["task"] for item in items],
        "episode_index": [item["episode_index"].item() for item in items],
        "timestamp": [item["timestamp"].item() for item in items],
        "last episode": len(last),
        "next actions": pairs[0]["action"].tolist(),
        "stats": {key: value.tolist() for key, value in whole.meta.stats["action"].items()},
        "picture stats": {key: whole.meta.stats[key]["mean"].ravel().tolist() for key in pictures},
    }


if __name__ == "__main__":
    try:
        import torchvision  # type: ignore[import-not-found]  # noqa: F401
    except Exception:  # missing, or made for another torch
        stand_in_for_torchvision()
    print(json.dumps(load(sys.argv[1])))  # noqa: T201
