"""The frozen policy file: weights and what they are. It cannot carry code.

A safetensors file. Its metadata holds "format" and "version"; "config" and "provenance" as
JSON; and "sha256", taken over all of these and over every tensor's name, type, shape and
content, so that a changed byte is noticed and the same policy has the same identity.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from policies.errors import CheckpointError
from policies.learned import LearnedPolicy
from policies.methods import METHODS
from policies.networks.build import WIDTHS, build
from policies.networks.maps import Network
from policies.safetensors import Arrays, canonical_json, pack, parse_json, table_of, unpack

FORMAT = "tdpg-policy"
VERSION = 1
MAX_BYTES = 256 * 2**20  # four times the paper's network

Migration = Callable[[Arrays, dict[str, str]], tuple[Arrays, dict[str, str]]]
MIGRATIONS: dict[int, Migration] = {}  # from this version to the next


@dataclass(frozen=True, kw_only=True)
class PolicyConfig:
    """What to build before the weights fit.

    network, width: see `networks.build.WIDTHS`. goal: whether the network reads the goal mask.
    method: see `methods.METHODS`.
    """

    network: str
    width: int
    goal: bool
    method: str

    def build(self) -> Network:
        """The network with fresh weights. Raises ValueError."""
        return build(self.network, goal=self.goal, width=self.width)


@dataclass(frozen=True, kw_only=True, eq=False)
class Checkpoint:
    """A policy file's content.

    weights: the network's state dict. provenance: how it came to be (command, commit, seeds,
    figures), JSON values. sha256: its identity, for logs.
    """

    config: PolicyConfig
    weights: dict[str, torch.Tensor]
    provenance: dict[str, Any]
    sha256: str

    def network(self) -> Network:
        """The network with its weights. Raises CheckpointError if they do not fit."""
        network = self.config.build()
        try:
            network.load_state_dict(self.weights)
        except RuntimeError as error:
            raise CheckpointError(f"the weights do not fit {self.config}: {error}") from error
        return network

    def policy(self, *, dtype: torch.dtype | None = None) -> LearnedPolicy:
        """Ready to decide. dtype: see LearnedPolicy."""
        method = METHODS[self.config.method]
        return LearnedPolicy(self.network(), method, goal=self.config.goal, dtype=dtype)


def policy_from_checkpoint(path: Path) -> LearnedPolicy:
    """Read a policy file, ready to decide. Raises CheckpointError."""
    return load_checkpoint(path).policy()


def save_checkpoint(
    path: Path, network: Network, config: PolicyConfig, provenance: Mapping[str, Any]
) -> str:
    """Freeze a network into a policy file, whole or not at all. Returns its SHA-256. Raises
    CheckpointError when the method needs another network."""
    _check_method(config)
    arrays = {
        name: tensor.detach().cpu().contiguous().numpy()
        for name, tensor in sorted(network.state_dict().items())
    }
    metadata = {
        "format": FORMAT,
        "version": str(VERSION),
        "config": canonical_json(dataclasses.asdict(config)),
        "provenance": canonical_json(dict(provenance)),
    }
    sha256 = _digest(arrays, metadata)
    partial = path.with_name(path.name + ".part")
    partial.write_bytes(pack(arrays, {**metadata, "sha256": sha256}))
    os.replace(partial, path)
    return sha256


def load_checkpoint(path: Path) -> Checkpoint:
    """Read and check a policy file; nothing in it is executed. Raises CheckpointError."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror})") from error
    if len(content) > MAX_BYTES:
        raise CheckpointError(f"{path}: larger than any policy ({MAX_BYTES} bytes)")
    try:
        return parse_checkpoint(content)
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from error


def parse_checkpoint(content: bytes) -> Checkpoint:
    """Bytes of a policy file -> its content. Raises CheckpointError."""
    arrays, metadata = unpack(content)
    if metadata.get("format") != FORMAT:
        raise CheckpointError("a safetensors file, but not a policy of this project")
    stated = metadata.pop("sha256", "none")
    actual = _digest(arrays, metadata)
    if stated != actual:
        raise CheckpointError(f"damaged or altered: SHA-256 is {actual}, the file states {stated}")
    arrays, metadata = _migrated(arrays, metadata)
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise CheckpointError(f"tensor {name} holds values that are not finite")
    return Checkpoint(
        config=_config(parse_json(metadata.get("config", ""), "config")),
        weights={name: torch.from_numpy(array) for name, array in arrays.items()},
        provenance=parse_json(metadata.get("provenance", ""), "provenance"),
        sha256=stated,
    )


def _digest(arrays: Arrays, metadata: Mapping[str, str]) -> str:
    digest = hashlib.sha256(canonical_json([dict(metadata), table_of(arrays)]).encode())
    for array in arrays.values():
        digest.update(array.tobytes())
    return digest.hexdigest()


def _migrated(arrays: Arrays, metadata: dict[str, str]) -> tuple[Arrays, dict[str, str]]:
    text = metadata.get("version", "")
    version = int(text) if text.isascii() and text.isdigit() and len(text) < 9 else 0
    if version > VERSION:
        raise CheckpointError(
            f"policy format {version} is newer than this program, which reads up to {VERSION}: "
            "update tdpg-deploy"
        )
    for step in range(version, VERSION):
        if step not in MIGRATIONS:
            raise CheckpointError(f"policy format {text!r} is not one that can be read")
        arrays, metadata = MIGRATIONS[step](arrays, metadata)
    return arrays, metadata


def _config(fields: dict[str, Any]) -> PolicyConfig:
    types: dict[str, type] = {"network": str, "width": int, "goal": bool, "method": str}
    if set(fields) != set(types):
        raise CheckpointError(f"config has the fields {sorted(fields)}, expected {sorted(types)}")
    for name, kind in types.items():
        if type(fields[name]) is not kind:
            raise CheckpointError(f"config.{name} = {fields[name]!r} is no {kind.__name__}")
    config = PolicyConfig(**fields)
    if config.network not in WIDTHS:
        raise CheckpointError(
            f"config.network = {config.network!r} is unknown; known are {', '.join(WIDTHS)}"
        )
    if config.width not in WIDTHS[config.network]:
        raise CheckpointError(f"config.width = {config.width} does not exist for {config.network}")
    if config.method not in METHODS:
        raise CheckpointError(
            f"config.method = {config.method!r} is unknown; known are {', '.join(METHODS)}"
        )
    _check_method(config)
    return config


def _check_method(config: PolicyConfig) -> None:
    if METHODS[config.method].choose is None and config.network != "coordinated":
        raise CheckpointError(
            f"config.method = {config.method!r} needs the network coordinated, not {config.network}"
        )
