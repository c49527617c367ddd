from __future__ import annotations

from pathlib import Path

import pytest
import torch

from policies.checkpoint import PolicyConfig, load_checkpoint, save_checkpoint
from policies.errors import CheckpointError
from policies.networks.light import LightNet
from policies.networks.twin import TwinNet
from tdpg_deploy.errors import ConfigError
from tools.train.curve import Curve, Progress, Validation
from tools.train.export import export, main


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run of one round that was validated."""
    directory = tmp_path / "run"
    directory.mkdir()
    torch.manual_seed(0)
    save_checkpoint(
        directory / "policy.safetensors",
        LightNet(goal=False, width=4),
        PolicyConfig(network="light", width=4, goal=False, method="tdpg"),
        {
            "start": {"sha256": "feed", "actions": 1000},
            "experiment": {"seed": 7},
            "actions": 6000,
            "updates": 1500,
            "commit": "abc1234",
        },
    )
    validation = Validation(completion=1.0, grasp_success=0.875, efficiency=0.8, motions=12.0)
    with Curve(directory, round=0) as curve:
        curve.add(
            Progress(
                round=1,
                stage="synergy",
                actions=6000,
                updates=1500,
                epsilon=0.1,
                learning_rate=1e-4,
                grasp_success=0.5,
                push_reward=0.5,
                huber=0.1,
                bce=0.2,
                td_error=0.3,
                validation=validation,
            )
        )
    return directory


def test_the_policy_comes_with_its_card(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "shipped" / "hard.safetensors"
    assert main([str(run), str(out), "--note", "For hard tables."]) == 0
    frozen, exported = load_checkpoint(run / "policy.safetensors"), load_checkpoint(out)
    for name, weight in frozen.weights.items():
        assert torch.equal(exported.weights[name], weight)
    assert exported.config == frozen.config
    assert exported.provenance["validation"]["grasp_success"] == 0.875
    assert exported.provenance["note"] == "For hard tables."
    card = out.with_suffix(".md").read_text()
    for fact in (
        "# hard",
        "For hard tables.",
        exported.sha256,
        "7000 actions, beyond the paper's budget of 4000",
        "grasp_success: 0.875",
        "1000 of the actions made the weights that it began with, `feed`",
        "abc1234",
        '"seed": 7',
    ):
        assert fact in card


def test_a_policy_may_decide_by_another_method_than_the_one_it_was_trained_with(
    run: Path, tmp_path: Path
) -> None:
    out = tmp_path / "sure.safetensors"
    export(run, out, method="tdpg-sure")
    assert load_checkpoint(out).config.method == "tdpg-sure"
    with pytest.raises(ConfigError, match="no method nonsense: one of grasp-only"):
        export(run, out, method="nonsense")


def test_a_directory_without_a_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"policy.safetensors: cannot be read"):
        export(tmp_path, tmp_path / "out.safetensors")
    assert main([str(tmp_path), str(tmp_path / "out.safetensors")]) == 2


def test_a_policy_file_ends_in_safetensors(run: Path) -> None:
    with pytest.raises(ConfigError, match=r"out.bin: a policy file ends in .safetensors"):
        export(run, run / "out.bin")


def test_the_weights_of_a_twin_are_exported_as_a_policy_that_fetches_too(
    run: Path, tmp_path: Path
) -> None:
    out = tmp_path / "fetch.safetensors"
    with pytest.raises(ConfigError, match="network light that clears tables read no goal"):
        export(run, out, goal=True)
    weights = run / "policy.safetensors"
    clears = PolicyConfig(network="twin", width=4, goal=False, method="tdpg-free")
    save_checkpoint(
        weights, TwinNet(goal=False, width=4), clears, load_checkpoint(weights).provenance
    )
    export(run, out, goal=True)
    exported = load_checkpoint(out)
    assert exported.policy().goal
    for name, weight in load_checkpoint(weights).weights.items():
        assert torch.equal(exported.weights[name], weight)
    assert "A policy that fetches" in out.with_suffix(".md").read_text()
