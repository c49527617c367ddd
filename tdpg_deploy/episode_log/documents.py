"""Frozen dataclasses <-> JSON documents, with the JSON schema that their types imply.

An object is its fields, and `kind`, the name of its class, which tells members of a union
apart. Enumerations are their values, arrays lists, a Transform a position (m) and a quaternion
(x, y, z, w). JSON has finite numbers only: others become null, and null where a number is due
becomes nan. Unknown keys are skipped and missing ones take the field's default, so that
neighbouring versions read each other.
"""

from __future__ import annotations

import json
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache
from math import isfinite, nan
from numbers import Integral, Real
from typing import Any, TypeAlias, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from policies.primitives import Primitive
from tdpg_deploy.errors import LogError
from tdpg_deploy.geometry import Transform

MAX_TEXT = 100_000  # characters; nothing of ours comes near, and who shows a text need not fear it

T = TypeVar("T")
_UNIMPORTED = {"Primitive": Primitive}  # what a module names in its types, but does not import


def encode(value: object) -> bytes:
    """A dataclass as UTF-8 JSON that any parser reads."""
    return json.dumps(_plain(value), allow_nan=False, separators=(",", ":")).encode()


def decode(kind: type[T] | types.UnionType, data: bytes) -> T:
    """The dataclass (or the member of the union `kind`) in `data`. Raises LogError."""
    try:
        result: T = _reader(cast(Any, kind))(json.loads(data.decode()))
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        name = getattr(kind, "__name__", str(kind))
        raise LogError(f"not a {name} document: {type(error).__name__}: {error}") from error
    return result


def flat(value: object) -> dict[str, str]:
    """The fields of a dataclass as MCAP metadata; those that are None are left out."""
    content = {key: item for key, item in _plain(value).items() if item is not None}
    return {k: v if isinstance(v, str) else json.dumps(v) for k, v in content.items()}


def schema(kind: Any) -> bytes:
    """JSON schema (draft 2020-12) of `kind`."""
    return json.dumps(
        {"$schema": "https://json-schema.org/draft/2020-12/schema", **_schema(kind)}
    ).encode()


# --- writing ----------------------------------------------------------------------------------


def _plain(value: Any) -> Any:
    if isinstance(value, Transform):
        return {
            "position": value.translation.tolist(),
            "quaternion": value.rotation.as_quat().tolist(),
        }
    if is_dataclass(value):
        content = {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
        return {"kind": type(value).__name__, **content}
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value) if isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value]  # tuples, lists, arrays


# --- reading ----------------------------------------------------------------------------------


Reader: TypeAlias = Callable[[Any], Any]


@cache
def _reader(kind: Any) -> Reader:
    """What turns a JSON value into a `kind`. Made once for each type: an audit reads millions."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return _member_reader(arguments)
    if origin is tuple:
        item = _reader(arguments[0])
        return lambda value: tuple([item(each) for each in _expect(list, value)])
    if origin is np.ndarray:
        return lambda value: np.array([_float(each) for each in _expect(list, value)], np.float64)
    if origin in (dict, Mapping):
        content = _reader(arguments[1])
        return lambda value: {key: content(each) for key, each in _expect(dict, value).items()}
    if kind is Transform:
        return lambda value: Transform.from_quaternion(value["position"], value["quaternion"])
    if kind is float:
        return _float
    if kind is int:
        return _integer
    if kind is str:
        return text
    if kind is bool:
        return lambda value: _expect(bool, value)
    if issubclass(kind, Enum):
        return lambda value: kind(text(value))
    return _object_reader(kind)


def _member_reader(members: tuple[Any, ...]) -> Reader:
    others = [member for member in members if member is not types.NoneType]
    by_name = {member.__name__: member for member in others} if len(others) > 1 else {}

    def read(value: Any) -> Any:
        if value is None and len(others) < len(members):
            return None
        return _reader(by_name[value["kind"]] if by_name else others[0])(value)

    return read


def _object_reader(kind: Any) -> Reader:
    hints = get_type_hints(kind, localns=_UNIMPORTED)
    readers = {field.name: _reader(hints[field.name]) for field in fields(kind)}
    required = {
        field.name
        for field in fields(kind)
        if field.default is MISSING and field.default_factory is MISSING
    }

    def read(value: Any) -> Any:
        document = _expect(dict, value)
        content = {name: read(document[name]) for name, read in readers.items() if name in document}
        if not content.keys() >= required:
            raise KeyError(min(required - content.keys()))
        return kind(**content)

    return read


def text(value: Any) -> str:
    """What a terminal would obey, and what no file can hold, is replaced (U+FFFD). Raises TypeError
    or ValueError for what is no text, or too long a one."""
    told: str = _expect(str, value)
    if len(told) > MAX_TEXT:
        raise ValueError(f"a text of {len(told)} characters; at most {MAX_TEXT} are read")
    if told.isprintable():
        return told
    return "".join(c if c.isprintable() or c in "\n\t" else "\ufffd" for c in told)


def _float(value: Any) -> float:
    if type(value) is float:  # the most frequent of all by far
        return value
    return nan if value is None else float(_expect((int, float), value))


def _integer(value: Any) -> int:
    whole: int = _expect(int, value)
    if whole.bit_length() > 63:
        raise OverflowError(f"an integer of {whole.bit_length()} bits")
    return whole


def _expect(kind: Any, value: Any) -> Any:
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise TypeError(f"{value!r:.80} is not a {getattr(kind, '__name__', 'number')}")
    return value


# --- schemas ----------------------------------------------------------------------------------

_NUMBER = {"type": ["number", "null"]}
_SCHEMAS: dict[Any, dict[str, Any]] = {
    float: _NUMBER,
    int: {"type": "integer"},
    str: {"type": "string"},
    bool: {"type": "boolean"},
    types.NoneType: {"type": "null"},
    Transform: {
        "type": "object",
        "properties": {
            "position": {"type": "array", "items": {"type": "number"}},
            "quaternion": {"type": "array", "items": {"type": "number"}},
        },
    },
}


def _schema(kind: Any) -> dict[str, Any]:
    if kind in _SCHEMAS:
        return _SCHEMAS[kind]
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return {"anyOf": [_schema(member) for member in arguments]}
    if origin is tuple:
        return {"type": "array", "items": _schema(arguments[0])}
    if origin is np.ndarray:
        return {"type": "array", "items": _NUMBER}
    if origin in (dict, Mapping):
        return {"type": "object", "additionalProperties": _schema(arguments[1])}
    if issubclass(kind, Enum):
        return {"enum": [member.value for member in kind]}
    hints = get_type_hints(kind, localns=_UNIMPORTED)
    properties = {field.name: _schema(hints[field.name]) for field in fields(kind)}
    return {
        "title": kind.__name__,
        "type": "object",
        "properties": {"kind": {"const": kind.__name__}, **properties},
    }
