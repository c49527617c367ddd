"""The frozen policy file: weights and what they are. It cannot carry code.

A safetensors file: eight bytes of header length (little-endian), a JSON header, raw tensors.
`__metadata__` holds strings only: "format", "version", "config" and "provenance" (JSON), and
"sha256" over all of these and the tensors. See docs/checkpoint.md.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from policies.errors import CheckpointError
from policies.learned import LearnedPolicy
from policies.methods import METHODS
from policies.networks.build import KINDS, build
from policies.networks.maps import Network

FORMAT = "tdpg-policy"
VERSION = 1
MAX_BYTES = 512 * 2**20  # ten times the paper's network
MAX_HEADER = 4 * 2**20
MAX_WIDTH = 64
_LENGTH = struct.Struct("<Q")


@dataclass(frozen=True, kw_only=True)
class PolicyConfig:
    """What to build before the weights fit. network: see `networks.build`. width: channels of
    the light network at stride 2. goal: whether it reads the goal mask. method: see `methods`."""

    network: str
    width: int
    goal: bool
    method: str

    def build(self) -> Network:
        return build(self.network, goal=self.goal, width=self.width)


@dataclass(frozen=True, kw_only=True, eq=False)
class Checkpoint:
    """A policy file's content.

    weights: the network's state dict, float32 and int64. provenance: how it came to be
    (command, commit, seeds, figures), JSON values. sha256: its identity, for logs.
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
            raise CheckpointError(f"weights do not fit {self.config}: {error}") from error
        return network

    def policy(self, *, dtype: torch.dtype | None = None) -> LearnedPolicy:
        method = METHODS[self.config.method]
        return LearnedPolicy(self.network(), method, goal=self.config.goal, dtype=dtype)


def policy_from_checkpoint(path: Path) -> LearnedPolicy:
    """Read a policy file, ready to decide. Raises CheckpointError."""
    return load_checkpoint(path).policy()


def save_checkpoint(
    path: Path, network: Network, config: PolicyConfig, provenance: Mapping[str, Any]
) -> str:
    """Freeze a network into a policy file, whole or not at all. Returns its SHA-256."""
    arrays = {
        name: np.ascontiguousarray(tensor.detach().cpu().contiguous().numpy())
        for name, tensor in sorted(network.state_dict().items())
    }
    table: dict[str, Any] = {}
    end = 0
    for name, array in arrays.items():
        start, end = end, end + array.nbytes
        dtype = _NAMES[array.dtype]
        table[name] = {"dtype": dtype, "shape": list(array.shape), "data_offsets": [start, end]}
    metadata = {
        "format": FORMAT,
        "version": str(VERSION),
        "config": _json(dataclasses.asdict(config)),
        "provenance": _json(dict(provenance)),
    }
    data = b"".join(array.tobytes() for array in arrays.values())
    metadata["sha256"] = _digest(metadata, table, data)
    header = _json({"__metadata__": metadata, **table}).encode()
    header += b" " * (-len(header) % 8)  # tensors start aligned
    partial = path.with_name(path.name + ".part")
    partial.write_bytes(_LENGTH.pack(len(header)) + header + data)
    os.replace(partial, path)
    return metadata["sha256"]


def load_checkpoint(path: Path) -> Checkpoint:
    """Read and check a policy file; nothing in it is executed. Raises CheckpointError."""
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > MAX_BYTES:
                raise CheckpointError(f"{path}: {size} bytes; a policy has at most {MAX_BYTES}")
            content = file.read(MAX_BYTES)
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror})") from error
    try:
        return parse_checkpoint(content)
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from error


def parse_checkpoint(content: bytes) -> Checkpoint:
    """Bytes of a policy file -> its content. Raises CheckpointError."""
    header, data = _split(content)
    metadata = header.pop("__metadata__", None)
    if not _is_ours(metadata):
        raise CheckpointError("a safetensors file, but not a policy of this project")
    version = metadata["version"]
    if version != str(VERSION):
        raise CheckpointError(
            f"policy format version {version}, but this program reads {VERSION}: update it"
        )
    stated = metadata.pop("sha256")
    actual = _digest(metadata, header, data)
    if stated != actual:
        raise CheckpointError(f"damaged or altered: SHA-256 is {actual}, the file states {stated}")
    return Checkpoint(
        config=_config(_from_json(metadata["config"], "config")),
        weights=_tensors(header, data),
        provenance=_from_json(metadata["provenance"], "provenance"),
        sha256=stated,
    )


# --- the container ----------------------------------------------------------------------------

_DTYPES: dict[str, np.dtype[Any]] = {"F32": np.dtype("<f4"), "I64": np.dtype("<i8")}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}


def _split(content: bytes) -> tuple[dict[str, Any], memoryview]:
    if content[:2] == b"PK" or content[:1] == b"\x80":
        raise CheckpointError(
            "a pickle (a file of torch.save), which can carry code: it was not opened; "
            "export the policy with tdpg-export"
        )
    if len(content) < _LENGTH.size:
        raise CheckpointError(f"truncated: {len(content)} bytes")
    (length,) = _LENGTH.unpack_from(content)
    if length > MAX_HEADER:
        raise CheckpointError("not a policy file: its first bytes are no header length")
    start = _LENGTH.size + length
    if len(content) < start:
        raise CheckpointError(f"truncated: the header ends at byte {start} of {len(content)}")
    try:
        header = _from_json(content[_LENGTH.size : start].decode(), "header")
    except UnicodeDecodeError as error:
        raise CheckpointError("not a policy file: the header is not text") from error
    return header, memoryview(content)[start:]


def _is_ours(metadata: object) -> bool:
    keys = {"format", "version", "config", "provenance", "sha256"}
    return (
        isinstance(metadata, dict)
        and metadata.get("format") == FORMAT
        and set(metadata) == keys
        and all(isinstance(value, str) for value in metadata.values())
    )


def _tensors(table: dict[str, Any], data: memoryview) -> dict[str, torch.Tensor]:
    """Tensors that lie one behind the other and fill `data`: none overlap, none is invented."""
    weights: dict[str, torch.Tensor] = {}
    at = 0
    for name, entry in sorted(table.items(), key=lambda item: _offsets(item[1])):
        dtype, shape = _DTYPES.get(entry.get("dtype")), entry.get("shape")
        if dtype is None or not _is_shape(shape):
            raise CheckpointError(f"tensor {name}: type or shape is not allowed: {entry}")
        count = int(np.prod(shape, dtype=object))
        start, end = _offsets(entry)
        if start != at or end - start != count * dtype.itemsize or end > len(data):
            raise CheckpointError(f"tensor {name}: truncated or misplaced")
        array = np.frombuffer(data, dtype, count, start).reshape(shape)
        weights[name] = torch.from_numpy(array.copy())
        at = end
    if at != len(data):
        raise CheckpointError(f"{len(data) - at} bytes behind the last tensor")
    return weights


def _offsets(entry: object) -> tuple[int, int]:
    offsets: Any = entry.get("data_offsets") if isinstance(entry, dict) else None
    if not _is_shape(offsets) or len(offsets) != 2:
        raise CheckpointError(f"tensor without offsets: {entry}")
    return offsets[0], offsets[1]


def _is_shape(value: Any) -> bool:
    return isinstance(value, list) and all(type(item) is int and item >= 0 for item in value)


def _digest(metadata: Mapping[str, str], table: Mapping[str, Any], data: Any) -> str:
    digest = hashlib.sha256(_json([dict(metadata), dict(table)]).encode())
    digest.update(data)
    return digest.hexdigest()


# --- the metadata -----------------------------------------------------------------------------


def _config(fields: dict[str, Any]) -> PolicyConfig:
    types: dict[str, type] = {"network": str, "width": int, "goal": bool, "method": str}
    if set(fields) != set(types):
        raise CheckpointError(f"config has the fields {sorted(fields)}, expected {sorted(types)}")
    for name, kind in types.items():
        if type(fields[name]) is not kind:
            raise CheckpointError(
                f"config.{name} = {fields[name]!r} is not of type {kind.__name__}"
            )
    config = PolicyConfig(**fields)
    _require_one_of("network", config.network, KINDS)
    _require_one_of("method", config.method, tuple(METHODS))
    if not 1 <= config.width <= MAX_WIDTH:
        raise CheckpointError(f"config.width = {config.width} is not within 1 to {MAX_WIDTH}")
    return config


def _require_one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise CheckpointError(f"config.{name} = {value!r} is unknown; known are {', '.join(known)}")


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _from_json(text: str, what: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise CheckpointError(f"{what} is not JSON") from error
    if not isinstance(value, dict):
        raise CheckpointError(f"{what} is not a JSON object")
    return value
