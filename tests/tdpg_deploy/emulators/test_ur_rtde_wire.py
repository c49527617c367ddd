"""RTDE packages against bytes written by hand from the RTDE guide."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tdpg_deploy.emulators.ur_controller import rtde_wire as wire
from tdpg_deploy.emulators.ur_controller.rtde_wire import (
    FieldType,
    Kind,
    Package,
    Recipe,
    WireError,
    split,
)

FINITE = st.floats(allow_nan=False)
VALUES: dict[FieldType, st.SearchStrategy[wire.Value]] = {
    FieldType.UINT32: st.integers(0, 2**32 - 1),
    FieldType.UINT64: st.integers(0, 2**64 - 1),
    FieldType.INT32: st.integers(-(2**31), 2**31 - 1),
    FieldType.DOUBLE: FINITE,
    FieldType.VECTOR3D: st.lists(FINITE, min_size=3, max_size=3),
    FieldType.VECTOR6D: st.lists(FINITE, min_size=6, max_size=6),
    FieldType.VECTOR6INT32: st.lists(st.integers(-(2**31), 2**31 - 1), min_size=6, max_size=6),
}
PACKAGES = st.builds(Package, kind=st.integers(0, 255), payload=st.binary(max_size=300))


def test_requests_of_a_client() -> None:
    version = bytes.fromhex("0005 56 0002")  # V, protocol version 2
    controller = bytes.fromhex("0003 76")  # v
    outputs = b"\x00\x1e\x4f" + struct.pack(">d", 125.0) + b"timestamp,actual_q,"
    packages, left = split(version + controller + outputs + b"\x00")
    assert [package.kind for package in packages] == [
        Kind.REQUEST_PROTOCOL_VERSION,
        Kind.GET_CONTROLLER_VERSION,
        Kind.SETUP_OUTPUTS,
    ]
    assert wire.parse_output_setup(packages[2].payload) == (125.0, ("timestamp", "actual_q"))
    assert left == b"\x00"


def test_replies_to_a_client() -> None:
    assert wire.accepted(Kind.REQUEST_PROTOCOL_VERSION) == bytes.fromhex("0004 56 01")
    assert wire.accepted(Kind.START, ok=False) == bytes.fromhex("0004 53 00")
    assert wire.controller_version((3, 15, 8, 106339)) == bytes.fromhex(
        "0013 76 00000003 0000000f 00000008 00019f63"
    )
    reply = wire.recipe_reply(Kind.SETUP_INPUTS, 1, ["INT32", "DOUBLE"])
    assert reply == b"\x00\x10\x49\x01INT32,DOUBLE"


def test_data_package() -> None:
    recipe = Recipe(id=2, names=("a", "b"), types=(FieldType.INT32, FieldType.VECTOR3D))
    expected = "0020 55 02 fffffffe 3ff0000000000000 c000000000000000 3fe0000000000000"
    data = bytes.fromhex(expected)
    assert recipe.pack([-2, [1.0, -2.0, 0.5]]) == data
    assert recipe.unpack(data[3:]) == {"a": -2, "b": [1.0, -2.0, 0.5]}


@settings(deadline=None)
@given(st.lists(PACKAGES, max_size=6), st.data())
def test_split_does_not_depend_on_how_bytes_arrive(
    sent: list[Package], data: st.DataObject
) -> None:
    stream = b"".join(package.encode() for package in sent)
    cut = data.draw(st.integers(0, len(stream)))
    first, left = split(stream[:cut])
    second, left = split(left + stream[cut:])
    assert first + second == sent
    assert left == b""


@settings(deadline=None)
@given(st.lists(st.sampled_from(FieldType), min_size=1, max_size=8), st.data())
def test_recipe_round_trip(types: list[FieldType], data: st.DataObject) -> None:
    names = tuple(f"v{i}" for i in range(len(types)))
    recipe = Recipe(id=1, names=names, types=tuple(types))
    values: list[wire.Value] = [data.draw(VALUES[kind]) for kind in types]
    packages, _ = split(recipe.pack(values))
    assert recipe.unpack(packages[0].payload) == dict(zip(names, values, strict=True))


def test_nonsense_is_refused() -> None:
    with pytest.raises(WireError, match="shorter than its header"):
        split(b"\x00\x02\x55")
    with pytest.raises(WireError, match="eight bytes of rate"):
        wire.parse_output_setup(b"time")
    with pytest.raises(WireError, match="not ASCII"):
        wire.parse_names("größe".encode())
    recipe = Recipe(id=1, names=("a",), types=(FieldType.INT32,))
    with pytest.raises(WireError, match="takes 5 bytes, got 4"):
        recipe.unpack(b"\x01\x00\x00\x00")
