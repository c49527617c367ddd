"""tdpg-run --real with the shipped checkpoint, through the true wires; beside the mock cell."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from emulated_cell import emulator, small_cell
from mcap.reader import make_reader
from ur_rig import processes_of

from tdpg_deploy.cli.run import main
from tdpg_deploy.episode_log.channels import REFUSAL
from tdpg_deploy.episode_log.entries import Intent, Refusal
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.outcome import EndReason

OBJECTS, SEED = 4, 501
STORY = re.compile(r"LookDocument (Intent LookDocument Conclusion )+End")


@pytest.mark.slow
@pytest.mark.real_time
def test_the_shipped_policy_clears_a_table_as_in_the_mock_cell(tmp_path: Path) -> None:
    table = ("--objects", str(OBJECTS), "--seed", str(SEED))
    config = small_cell()
    with emulator(config, *table, "--pace", "4") as rig:
        told = ("--config", str(rig.file), "--seed", str(SEED))
        real = ("--real", "--unattended", "--speed", "1", "--out", str(tmp_path / "real"))
        assert main([*told, *real]) == 0
        assert rig.do("objects") == {"workspace": 0, "bin": OBJECTS, "outside": 0}
        assert processes_of(rig.host) == {}  # the driver's child is gone
        assert main([*told, *table, "--out", str(tmp_path / "mock")]) == 0

    emulated, mock = (logged(tmp_path / cell) for cell in ("real", "mock"))
    assert emulated.about.checkpoint_sha256 == mock.about.checkpoint_sha256 is not None
    assert channels(emulated.path) == channels(mock.path)
    for episode in (emulated, mock):
        assert STORY.fullmatch(story(episode))
        result = episode.result()
        assert result is not None
        assert result.reason is EndReason.CLEARED
        assert result.delivered == OBJECTS
    ours, theirs = first_intent(emulated), first_intent(mock)
    for name in ("rotation", "row", "col"):
        assert getattr(ours.decision, name) == getattr(theirs.decision, name)
    # The wire carries counts, the mock cell metres: they agree but for a float's last bits.
    assert ours.decision.primitive.z == pytest.approx(theirs.decision.primitive.z, abs=1e-6)
    assert ours.decision.q == pytest.approx(theirs.decision.q, abs=1e-3)


def logged(directory: Path) -> Episode:
    (log,) = directory.glob("*.mcap")
    return read_episode(log)


def channels(log: Path) -> set[tuple[str, str, str]]:
    """Topic, schema and encoding; that of refusals depends on what is chosen."""
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return {
        (channel.topic, summary.schemas[channel.schema_id].name, channel.message_encoding)
        for channel in summary.channels.values()
        if channel.topic != REFUSAL
    }


def story(episode: Episode) -> str:
    """Kinds of entries in order, but for states and refusals."""
    entries = episode.entries(images=False, states=False)
    return " ".join(type(entry).__name__ for entry in entries if not isinstance(entry, Refusal))


def first_intent(episode: Episode) -> Intent:
    return next(e for e in episode.entries(images=False, states=False) if isinstance(e, Intent))
