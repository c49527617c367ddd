"""The safetensors container, written and read strictly: JSON and raw numbers, no code.

Eight bytes of header length (little-endian), the header, the tensors one behind the other.
Format: https://github.com/huggingface/safetensors, "Format". Only float32 and int64 are taken.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from policies.errors import CheckpointError

Arrays = dict[str, npt.NDArray[Any]]

MAX_HEADER = 4 * 2**20  # bytes
_LENGTH = struct.Struct("<Q")
_DTYPES: dict[str, np.dtype[Any]] = {"F32": np.dtype("<f4"), "I64": np.dtype("<i8")}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}


def table_of(arrays: Arrays) -> dict[str, Any]:
    """The header's entry of each array, in the order given."""
    table: dict[str, Any] = {}
    end = 0
    for name, array in arrays.items():
        start, end = end, end + array.nbytes
        dtype = _NAMES[array.dtype]
        table[name] = {"dtype": dtype, "shape": list(array.shape), "data_offsets": [start, end]}
    return table


def pack(arrays: Arrays, metadata: Mapping[str, str]) -> bytes:
    """The whole file."""
    header = canonical_json({"__metadata__": dict(metadata), **table_of(arrays)}).encode()
    header += b" " * (-len(header) % 8)  # so that the tensors start aligned
    return b"".join((_LENGTH.pack(len(header)), header, *(a.tobytes() for a in arrays.values())))


def unpack(content: bytes) -> tuple[Arrays, dict[str, str]]:
    """The whole file -> arrays (copied, in file order) and metadata. Raises CheckpointError."""
    header, data = _split(content)
    metadata = header.pop("__metadata__", {})
    if not isinstance(metadata, dict) or not all(isinstance(v, str) for v in metadata.values()):
        raise CheckpointError("__metadata__ must map names to strings")
    return _arrays(header, data), metadata


def canonical_json(value: Any) -> str:
    """The one way to write a value."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def parse_json(text: str, what: str) -> dict[str, Any]:
    """A JSON object. Raises CheckpointError."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"{what} is not JSON") from error
    if not isinstance(value, dict):
        raise CheckpointError(f"{what} is not a JSON object")
    return value


def _split(content: bytes) -> tuple[dict[str, Any], memoryview]:
    if content[:4] == b"PK\x03\x04" or (content[:1] == b"\x80" and content[-1:] == b"."):
        raise CheckpointError(
            "a pickle (written by torch.save), which can carry code: it was not opened; "
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
        text = content[_LENGTH.size : start].decode()
    except UnicodeDecodeError as error:
        raise CheckpointError("not a policy file: the header is not text") from error
    return parse_json(text, "the header"), memoryview(content)[start:]


def _arrays(table: dict[str, Any], data: memoryview) -> Arrays:
    """Arrays that lie one behind the other and fill `data`: so a file cannot ask for more
    memory than it brings."""
    arrays: Arrays = {}
    at = 0
    for name, entry in sorted(table.items(), key=lambda item: _offsets(*item)):
        start, end = _offsets(name, entry)
        dtype, shape = _DTYPES.get(str(entry.get("dtype"))), entry.get("shape")
        if dtype is None or not _are_sizes(shape):
            raise CheckpointError(f"tensor {name}: type or shape is not allowed: {entry}")
        count = 1
        for side in shape:
            count *= side  # Python's integers: no overflow
        if start != at or end - start != count * dtype.itemsize or end > len(data):
            raise CheckpointError(f"tensor {name}: truncated or misplaced")
        arrays[name] = np.frombuffer(data, dtype, count, start).reshape(shape).copy()
        at = end
    if at != len(data):
        raise CheckpointError(f"{len(data) - at} bytes behind the last tensor")
    return arrays


def _offsets(name: str, entry: Any) -> tuple[int, int]:
    offsets: Any = entry.get("data_offsets") if isinstance(entry, dict) else None
    if not _are_sizes(offsets) or len(offsets) != 2:
        raise CheckpointError(f"tensor {name}: no data_offsets in {entry}")
    return offsets[0], offsets[1]


def _are_sizes(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) <= 8
        and all(type(item) is int and 0 <= item < 2**40 for item in value)
    )
