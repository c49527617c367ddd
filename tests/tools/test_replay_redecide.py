"""Logged episodes decided again: bit for bit, or the first divergence and its cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from kinematic_log import write_log

from policies.baselines import RandomPolicy
from policies.checkpoint import PolicyConfig, load_checkpoint, save_checkpoint
from policies.heightmap import Heightmap
from policies.policy import Decider, Decision
from policies.primitives import Primitive, Push
from policies.shipped import NamedPolicy, open_policy
from tdpg_deploy.calibration_file import Calibration, DepthSection
from tdpg_deploy.cell_config import DEFAULT_CELL, load_cell
from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.entries import LoggedDecision, Step
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.hal import RgbdFrame
from tdpg_deploy.outcome import EndReason
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.session import log_episode
from tdpg_deploy.sim.hurry import in_a_hurry
from tdpg_deploy.workspace import workspace_of
from tools.evaluate.tables import challenge_cases
from tools.replay.assumptions import with_camera_moved
from tools.replay.divergence import (
    Cause,
    Divergence,
    Stage,
    Surroundings,
    differing,
    first_divergence,
)
from tools.replay.redecide import goal_pixels, redecide


class Overreaching(RandomPolicy):
    """Chance, but what it thinks of first at each look is out of reach."""

    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        decision = super().decide(heightmap, rng, avoid=avoid)
        if avoid:
            return decision
        return replace(decision, primitive=replace(decision.primitive, x=2.0))


CHANCE = NamedPolicy(name="random", decider=RandomPolicy(pushes=True), sha256=None)


def checkpoint(path: Path, seed: int) -> Path:
    torch.manual_seed(seed)
    config = PolicyConfig(network="light", width=8, goal=False, method="tdpg")
    save_checkpoint(path, config.build(), config, {})
    return path


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return checkpoint(tmp_path_factory.mktemp("weights") / "log.safetensors", 1)


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory, weights: Path) -> Episode:
    """Two actions of an untrained network with Critic II."""
    path = tmp_path_factory.mktemp("logs") / "learned.mcap"
    return write_log(path, open_policy(str(weights)), actions=2)


@pytest.fixture(scope="module")
def chance(tmp_path_factory: pytest.TempPathFactory) -> Episode:
    """Six random grasps and pushes, some of them futile."""
    path = tmp_path_factory.mktemp("logs") / "random.mcap"
    return write_log(path, CHANCE, actions=6, slippery=True)


def diverging(
    episode: Episode, policy: Decider, again: Surroundings | None = None
) -> list[Divergence]:
    logged = Surroundings.of(episode.about)
    compared = [
        first_divergence(step, logged, again or logged) for step in redecide(episode, policy)
    ]
    assert compared
    return [divergence for divergence in compared if divergence is not None]


# --- the same again ---------------------------------------------------------------------------


def test_a_network_decides_the_same_bit_for_bit(learned: Episode, weights: Path) -> None:
    assert diverging(learned, load_checkpoint(weights).policy()) == []


@pytest.mark.slow
def test_a_push_that_was_foreseen_is_foreseen_again(tmp_path: Path) -> None:
    """By the shipped policy, which finds a goal between two others and pushes it free."""
    cell, path = in_a_hurry(load_cell(DEFAULT_CELL)), tmp_path / "foreseen.mcap"
    table = next(table for table in challenge_cases() if table.name == "case-2-sandwich")
    scene, policy = table.scene(cell, 4_001, goal=True), open_policy(goal=True)
    result = log_episode(cell, policy, path, seed=4_001, scene=scene, goal=True)
    assert result.reason is EndReason.GOAL_REACHED
    episode = read_episode(path)
    first, *_ = redecide(episode, policy.decider)
    assert isinstance(first.again[-1].decision.primitive, Push)
    assert first.again[-1].decision.p_foreseen
    assert [one.decision.p_foreseen for one in first.again] == [
        one.decision.p_foreseen for one in first.logged
    ]
    assert diverging(episode, policy.decider) == []


def test_chance_draws_the_same_through_refusals_and_futile_actions(tmp_path: Path) -> None:
    policy = Overreaching(pushes=True)
    refused = replace(CHANCE, decider=policy)
    episode = write_log(tmp_path / "refused.mcap", refused, actions=6, slippery=True)
    steps = list(redecide(episode, policy))
    assert diverging(episode, policy) == []
    assert len(steps) == 6
    assert sum(len(step.again) for step in steps) > 6  # some were refused
    assert all(step.step.outcome for step in steps)


def test_another_seed_draws_another_action_and_nothing_explains_it(chance: Episode) -> None:
    other = Episode(path=chance.path, about=replace(chance.about, seed=99, commit=None))
    first = diverging(other, RandomPolicy(pushes=True))[0]
    assert first.number == 1
    assert first.cause is Cause.UNKNOWN


# --- the first divergence and its cause -------------------------------------------------------


def test_other_weights_are_named(learned: Episode, tmp_path: Path) -> None:
    policy = open_policy(str(checkpoint(tmp_path / "other.safetensors", 2)))
    again = replace(
        Surroundings.of(learned.about), policy=policy.name, checkpoint_sha256=policy.sha256
    )
    first = diverging(learned, policy.decider, again)[0]
    assert (first.stage, first.cause) == (Stage.VALUES, Cause.WEIGHTS)
    assert "other.safetensors" in first.evidence[0]
    assert first.value_error > 0


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"commit": "0" * 40}, Cause.CODE),
        ({"commit": "same", "versions": {"numpy": "0.1"}}, Cause.NUMERICS),
        ({"commit": "same"}, Cause.UNKNOWN),
        ({"commit": "same-dirty"}, Cause.CODE),
    ],
)
def test_another_heightmap_is_laid_to_what_differs(
    chance: Episode, monkeypatch: pytest.MonkeyPatch, change: dict[str, object], cause: Cause
) -> None:
    def lifted(*args: object, **options: object) -> Heightmap:
        right = build_heightmap(*args, **options)  # type: ignore[arg-type]
        return replace(right, height=right.height + np.float32(0.001))

    monkeypatch.setattr("tools.replay.redecide.build_heightmap", lifted)
    commit = "same-dirty" if change["commit"] == "same-dirty" else "same"
    about = replace(chance.about, commit=commit)
    again = replace(Surroundings.of(about), **change)  # type: ignore[arg-type]
    episode = Episode(path=chance.path, about=about)
    first = diverging(episode, RandomPolicy(pushes=True), again)[0]
    assert (first.stage, first.cause) == (Stage.HEIGHTMAP, cause)
    assert "by up to 1 mm" in first.found
    assert first.same_action  # decided on the logged heightmap
    assert first.within_tolerance


def test_another_calibration_file_is_told_by_its_date(chance: Episode) -> None:
    logged = Surroundings.of(chance.about)
    date = datetime(2026, 5, 4, 12, 30, tzinfo=timezone.utc)
    depth = DepthSection(a=1.01, b=-0.002, offset=0, rms=0, fill=1, left=0)
    some: dict[str, Any] = {"date": date, "depth": depth, "tags": {0: ((0.0, 0.0),) * 4}}
    made = Calibration.model_construct(**some)
    camera = logged.cell.camera.model_copy(update={"calibration": made})
    again = replace(logged, cell=logged.cell.model_copy(update={"camera": camera}))
    new = "that of 2026-05-04 12:30+00:00 (depth: a = 1.01, b = -0.002 1/m)"
    assert differing(logged, again) == {
        Cause.CALIBRATION: [f"the calibration file is {new}, in the log none"]
    }


def test_a_rounding_of_the_values_is_within_tolerance(
    learned: Episode, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = load_checkpoint(weights).policy()
    about = learned.about
    versions = {**about.versions, "processor": "another"}
    again = replace(Surroundings.of(about), versions=versions)
    exact = LoggedDecision.of

    def rounded(decision: Decision) -> LoggedDecision:
        logged = exact(decision)
        grasps = tuple(replace(grasp, q=grasp.q + 1e-6) for grasp in logged.grasps)
        return replace(logged, grasps=grasps, maps_sha256="0")

    monkeypatch.setattr(LoggedDecision, "of", rounded)
    clean = Episode(path=learned.path, about=replace(about, commit=None))
    again = replace(again, commit=None)
    first = diverging(clean, policy, again)[0]
    assert (first.stage, first.cause) == (Stage.VALUES, Cause.NUMERICS)
    assert first.evidence == (f"processor another, in the log {about.versions['processor']}",)
    assert first.value_error == pytest.approx(1e-6, abs=1e-9)
    assert first.within_tolerance


def test_a_tighter_limit_refuses_what_was_planned(chance: Episode) -> None:
    """The cell file forbids to come within 50 mm of the table, so every grasp is refused."""
    limits = chance.about.cell.limits.model_copy(update={"table_clearance": 0.05})
    other = chance.about.cell.model_copy(update={"limits": limits})
    again = replace(Surroundings.of(chance.about), cell=other)
    logged = Surroundings.of(chance.about)
    steps = redecide(chance, RandomPolicy(pushes=True), other)
    found = [first_divergence(step, logged, again) for step in steps]
    first = next(divergence for divergence in found if divergence is not None)
    assert (first.stage, first.cause) == (Stage.PLAN, Cause.CONFIG)
    assert first.evidence[0].startswith("limits.table_clearance is 0.05, in the log 0.0")


def test_a_lost_look_is_skipped(chance: Episode) -> None:
    class Recovered:
        about: About = chance.about

        def steps(self, *, states: bool) -> Iterator[Step]:
            first, *rest = chance.steps(states=states)
            yield replace(first, look=None)
            yield from rest

    lost, *_ = redecide(Recovered(), RandomPolicy(pushes=True))  # type: ignore[arg-type]
    assert (lost.again, lost.rebuilt) == ((), None)
    assert first_divergence(lost, *[Surroundings.of(chance.about)] * 2) is None


# --- what if ----------------------------------------------------------------------------------


def test_a_camera_that_hung_higher_lifts_all_that_was_seen(chance: Episode) -> None:
    """By as much, whatever the view: z of base is the heights' axis."""
    moved = with_camera_moved(chance.about.cell, np.array([0.0, 0.0, 0.005]))
    step = next(redecide(chance, RandomPolicy(pushes=True), moved))
    assert step.seen is step.rebuilt
    assert step.seen is not None
    assert step.step.look is not None
    lift = step.seen.height - step.step.look.heightmap.height
    assert np.nanmax(np.abs(lift - 0.005)) < 1e-6


def test_a_camera_moved_by_whole_pixels_shifts_the_map(chance: Episode) -> None:
    """10 mm along +x of base are five rows up."""
    moved = with_camera_moved(chance.about.cell, np.array([0.010, 0.0, 0.0]))
    step = next(redecide(chance, RandomPolicy(pushes=True), moved))
    assert step.seen is not None
    assert step.step.look is not None
    shifted, logged = step.seen.height[:-5], step.step.look.heightmap.height[5:]
    both = np.isfinite(shifted) & np.isfinite(logged)
    assert both.mean() > 0.9
    same = np.abs(shifted - logged)[both] < 1e-4  # pixels' borders fall a rounding elsewhere
    assert same.mean() > 0.95


def test_the_goal_is_found_again_in_the_frame(tmp_path: Path) -> None:
    def nearer_half(frame: RgbdFrame) -> npt.NDArray[np.bool_]:
        return np.asarray(frame.depth < 0.97)  # the boxes' tops lie 40, 50 and 70 mm high

    policy = NamedPolicy(name="random", decider=RandomPolicy(), sha256=None)
    episode = write_log(tmp_path / "goal.mcap", policy, actions=1, goal_pixels=nearer_half)
    look = next(episode.steps()).look
    assert look is not None
    assert look.heightmap.goal is not None
    config = episode.about.cell
    again = build_heightmap(
        look.frame,
        config.X_base_camera,
        workspace_of(config),
        goal_pixels=goal_pixels(look, config.X_base_camera),
    ).goal
    assert again is not None
    assert (again & look.heightmap.goal).sum() == look.heightmap.goal.sum() > 1500
    assert again.sum() < 1.02 * look.heightmap.goal.sum()
