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
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache
from math import isfinite, nan
from numbers import Integral, Real
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from tdpg_deploy.errors import LogError
from tdpg_deploy.geometry import Transform

T = TypeVar("T")


def encode(value: object) -> bytes:
    """A dataclass as UTF-8 JSON that any parser reads."""
    return json.dumps(_plain(value), allow_nan=False, separators=(",", ":")).encode()


def decode(kind: type[T] | types.UnionType, data: bytes) -> T:
    """The dataclass (or the member of the union `kind`) in `data`. Raises LogError."""
    try:
        result: T = _typed(kind, json.loads(data))
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


@cache
def _field_types(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _typed(kind: Any, value: Any) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return _member(arguments, value)
    if origin is tuple:
        return tuple(_typed(arguments[0], item) for item in _expect(list, value))
    if origin is np.ndarray:
        return np.array([_typed(float, item) for item in _expect(list, value)], np.float64)
    if origin in (dict, Mapping):
        return {key: _typed(arguments[1], item) for key, item in _expect(dict, value).items()}
    if kind is Transform:
        return Transform.from_quaternion(value["position"], value["quaternion"])
    if kind is float:
        return nan if value is None else float(_expect((int, float), value))
    if kind in (int, str, bool):
        return _expect(kind, value)
    if issubclass(kind, Enum):
        return kind(value)
    return _object(kind, _expect(dict, value))


def _member(members: tuple[Any, ...], value: Any) -> Any:
    if value is None and types.NoneType in members:
        return None
    others = [member for member in members if member is not types.NoneType]
    if len(others) == 1:
        return _typed(others[0], value)
    by_name = {member.__name__: member for member in others}
    return _typed(by_name[value["kind"]], value)


def _object(kind: Any, document: dict[str, Any]) -> Any:
    hints = _field_types(kind)
    content = {}
    for field in fields(kind):
        if field.name in document:
            content[field.name] = _typed(hints[field.name], document[field.name])
        elif field.default is MISSING and field.default_factory is MISSING:
            raise KeyError(field.name)
    return kind(**content)


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
    hints = _field_types(kind)
    properties = {field.name: _schema(hints[field.name]) for field in fields(kind)}
    return {
        "title": kind.__name__,
        "type": "object",
        "properties": {"kind": {"const": kind.__name__}, **properties},
    }
