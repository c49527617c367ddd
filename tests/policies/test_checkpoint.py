from __future__ import annotations

import io
import json
import os
import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from policies import checkpoint
from policies.checkpoint import (
    PolicyConfig,
    load_checkpoint,
    parse_checkpoint,
    policy_from_checkpoint,
    save_checkpoint,
)
from policies.errors import CheckpointError
from policies.networks.maps import Network
from policies.safetensors import Arrays, pack

CONFIG = PolicyConfig(network="light", width=4, goal=False, method="tdpg")
PROVENANCE = {"command": "train", "seeds": [1, 2], "figures": {"grasp_success": 0.9}}


@pytest.fixture(scope="module")
def network() -> Network:
    torch.manual_seed(0)
    return CONFIG.build()


@pytest.fixture(scope="module")
def file(network: Network, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "policy.safetensors"
    save_checkpoint(path, network, CONFIG, PROVENANCE)
    return path


def open_by_the_specification(content: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read safetensors as its format says, without a check."""
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    data, types = content[8 + length :], {"F32": "<f4", "I64": "<i8"}
    return header.pop("__metadata__"), {
        name: np.frombuffer(data[slice(*entry["data_offsets"])], types[entry["dtype"]]).reshape(
            entry["shape"]
        )
        for name, entry in header.items()
    }


def test_a_round_trip_is_exact(network: Network, file: Path) -> None:
    frozen = load_checkpoint(file)
    assert frozen.config == CONFIG
    assert frozen.provenance == PROVENANCE
    state = network.state_dict()
    assert set(frozen.network().state_dict()) == set(state)
    for name, weight in frozen.network().state_dict().items():
        assert torch.equal(weight, state[name])
    assert policy_from_checkpoint(file).method.name == "tdpg"


def test_the_same_policy_has_the_same_identity(
    network: Network, file: Path, tmp_path: Path
) -> None:
    again = tmp_path / "again.safetensors"
    sha256 = save_checkpoint(again, network, CONFIG, PROVENANCE)
    assert again.read_bytes() == file.read_bytes()
    assert sha256 == load_checkpoint(file).sha256
    other = save_checkpoint(again, network, CONFIG, {})
    assert other != sha256
    assert [path.name for path in tmp_path.iterdir()] == ["again.safetensors"]


def test_it_is_a_safetensors_file(network: Network, file: Path) -> None:
    metadata, tensors = open_by_the_specification(file.read_bytes())
    assert metadata["format"] == "tdpg-policy"
    for name, weight in network.state_dict().items():
        np.testing.assert_array_equal(tensors[name], weight.numpy())


def test_batch_norm_counters_survive(tmp_path: Path) -> None:
    config = PolicyConfig(network="densenet121", width=32, goal=True, method="vpg")
    path = tmp_path / "densenet.safetensors"
    save_checkpoint(path, config.build(), config, {})
    counter = "color_tower.features.norm0.num_batches_tracked"
    assert load_checkpoint(path).weights[counter].dtype == torch.int64
    assert path.stat().st_size < 80e6


# --- files that are refused -------------------------------------------------------------------


class Explosive:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("exploded",)


def torch_file(value: object, *, zipped: bool = True) -> bytes:
    buffer = io.BytesIO()
    torch.save(value, buffer, _use_new_zipfile_serialization=zipped)
    return buffer.getvalue()


def test_code_in_a_file_is_not_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "policy"
    for hostile in (
        pickle.dumps(Explosive()),
        torch_file({"weights": Explosive()}),
        torch_file({"weights": Explosive()}, zipped=False),
    ):
        path.write_bytes(hostile)
        with pytest.raises(CheckpointError, match="pickle"):
            load_checkpoint(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["policy"]


def test_a_state_dict_of_vpg_is_foreign(tmp_path: Path) -> None:
    path = tmp_path / "vpg.pth"
    path.write_bytes(torch_file({"push_color_trunk.features.conv0.weight": torch.zeros(3)}))
    with pytest.raises(CheckpointError, match=r"vpg\.pth: a pickle .* tdpg-export"):
        load_checkpoint(path)


def test_a_foreign_safetensors_file_is_named_so() -> None:
    with pytest.raises(CheckpointError, match="not a policy of this project"):
        parse_checkpoint(pack({"weight": np.zeros(3, np.float32)}, {"format": "pt"}))


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"nothing: cannot be read \(No such file"):
        load_checkpoint(tmp_path / "nothing")
    with pytest.raises(CheckpointError, match=r"cannot be read \(Is a directory"):
        load_checkpoint(tmp_path)


def test_a_huge_file_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "MAX_BYTES", 100)
    path = tmp_path / "policy"
    path.write_bytes(bytes(101))
    with pytest.raises(CheckpointError, match="larger than any policy"):
        load_checkpoint(path)


def every_kind_of_damage(content: bytes, at: int, flip: int, cut: bool) -> bytes:
    at %= len(content)
    if cut:
        return content[:at]
    return content[:at] + bytes([content[at] ^ flip]) + content[at + 1 :]


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**20), st.integers(1, 255), st.booleans())
def test_any_damage_is_noticed(file: Path, at: int, flip: int, cut: bool) -> None:
    with pytest.raises(CheckpointError):
        parse_checkpoint(every_kind_of_damage(file.read_bytes(), at, flip, cut))


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=200))
def test_noise_is_no_policy(content: bytes) -> None:
    with pytest.raises(CheckpointError):
        parse_checkpoint(content)


def test_an_altered_weight_is_named_an_alteration(file: Path) -> None:
    content = file.read_bytes()
    with pytest.raises(CheckpointError, match=r"damaged or altered: SHA-256 is .{64}, the"):
        parse_checkpoint(content[:-1] + bytes([content[-1] ^ 1]))


def with_header(entry: object) -> bytes:
    header = json.dumps({"weight": entry}).encode()
    return struct.pack("<Q", len(header)) + header + bytes(16)


@pytest.mark.parametrize(
    "entry",
    [
        {"dtype": "F32", "shape": [2**39], "data_offsets": [0, 2**39 * 4]},  # 2 TB
        {"dtype": "F32", "shape": [2**39, 2**39, 0], "data_offsets": [0, 4]},
        {"dtype": "F32", "shape": [4], "data_offsets": [4, 20]},
        {"dtype": "F32", "shape": [3], "data_offsets": [0, 12]},  # bytes left over
        {"dtype": "F32", "shape": [-4], "data_offsets": [0, -16]},
        {"dtype": "F32", "shape": [True], "data_offsets": [0, 4]},
        {"dtype": "O", "shape": [4], "data_offsets": [0, 16]},
        {"dtype": ["F32"], "shape": [4], "data_offsets": [0, 16]},
        {"dtype": "F32", "shape": [1] * 4 + [4] + [1] * 60, "data_offsets": [0, 16]},
        {"shape": [4]},
        "weight",
        None,
    ],
)
def test_a_tensor_must_lie_in_the_file(entry: object) -> None:
    with pytest.raises(CheckpointError, match="tensor"):
        parse_checkpoint(with_header(entry))


def sealed(arrays: Arrays, **metadata: str) -> bytes:
    """A file whose hash is right, whatever it holds."""
    return pack(arrays, {**metadata, "sha256": checkpoint._digest(arrays, metadata)})


def sealed_config(**changes: object) -> bytes:
    config = {"network": "light", "width": 4, "goal": False, "method": "tdpg", **changes}
    return sealed({}, format="tdpg-policy", version="1", config=json.dumps(config), provenance="{}")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"network": "resnet"},
            "config.network = 'resnet' is unknown; known are light, twin, coord",
        ),
        ({"width": "16"}, "config.width = '16' is no int"),
        ({"width": 10**6}, "config.width = 1000000 does not exist for light"),
        ({"goal": 0}, "config.goal = 0 is no bool"),
        ({"method": "dqn"}, "config.method = 'dqn' is unknown; known are grasp-only, vpg"),
        ({"method": "gi"}, "config.method = 'gi' needs the network coordinated, not light"),
        ({"extra": 1}, "config has the fields .*'extra'"),
    ],
)
def test_a_wrong_config_is_named(changes: dict[str, object], message: str) -> None:
    with pytest.raises(CheckpointError, match=message):
        parse_checkpoint(sealed_config(**changes))


def test_weights_must_fit_and_be_finite() -> None:
    with pytest.raises(CheckpointError, match=r"do not fit .*(\n.*)*stem\.weight"):
        parse_checkpoint(sealed_config()).network()
    with pytest.raises(CheckpointError, match="tensor a holds values that are not finite"):
        parse_checkpoint(
            sealed({"a": np.array([np.nan], np.float32)}, format="tdpg-policy", version="1")
        )


@pytest.mark.parametrize(
    ("version", "message"),
    [("2", "format 2 is newer than this program"), ("0", "'0' is not one"), ("x", "'x' is not")],
)
def test_another_version_is_named(version: str, message: str) -> None:
    with pytest.raises(CheckpointError, match=message):
        parse_checkpoint(sealed({}, format="tdpg-policy", version=version))


def test_an_older_version_is_migrated(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def renamed(arrays: Arrays, metadata: dict[str, str]) -> tuple[Arrays, dict[str, str]]:
        return {"stem.weight": arrays["old"]}, metadata

    monkeypatch.setattr(checkpoint, "VERSION", 2)
    monkeypatch.setattr(checkpoint, "MIGRATIONS", {1: renamed})
    config = json.dumps({"network": "light", "width": 4, "goal": False, "method": "vpg"})
    old = sealed(
        {"old": np.ones(2, np.float32)},
        format="tdpg-policy",
        version="1",
        config=config,
        provenance="{}",
    )
    assert list(parse_checkpoint(old).weights) == ["stem.weight"]
