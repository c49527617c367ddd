"""A log in Rerun: its own importer reads the images and frames; what it leaves as bytes, the
documents, are added as curves and text.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tdpg_deploy.episode_log import channels, documents
from tdpg_deploy.episode_log.entries import Conclusion, ForceDocument, LoggedDecision, Refusal
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.errors import ConfigError
from tdpg_deploy.hal import GripperState
from tools.replay import telling
from tools.replay.blueprint import FINGERS, FORCE, TIMELINE, TOLD, build_blueprint
from tools.replay.messages_of import RawMessage, raw_messages


def write_rrd(episode: Episode, path: Path) -> None:
    """Into a file, with the blueprint. Raises ConfigError without rerun-sdk."""
    rr = _rerun()
    recording = _recording(rr, episode)
    recording.save(path, default_blueprint=build_blueprint())
    _log(rr, recording, episode)
    recording.disconnect()


def open_in_rerun(episode: Episode) -> None:
    """In a viewer of its own. Raises ConfigError without rerun-sdk."""
    rr = _rerun()
    recording = _recording(rr, episode)
    recording.spawn(default_blueprint=build_blueprint())
    _log(rr, recording, episode)
    recording.flush()


def _rerun() -> Any:
    try:
        return import_module("rerun")
    except ImportError as error:
        raise ConfigError("Rerun needs rerun-sdk: pip install 'tdpg-deploy[view]'") from error


def _recording(rr: Any, episode: Episode) -> Any:
    return rr.RecordingStream("tdpg-deploy", recording_id=episode.path.stem)


def _log(rr: Any, recording: Any, episode: Episode) -> None:
    recording.log_file_from_path(episode.path)
    for message in raw_messages(episode, images=False):
        if message.topic in _TOLD:
            entity, value = _TOLD[message.topic](rr, message)
            recording.set_time(TIMELINE, timestamp=np.datetime64(message.publish_time, "ns"))
            recording.log(entity, value)


def _force(rr: Any, message: RawMessage) -> tuple[str, Any]:
    return FORCE, rr.Scalars(documents.decode(ForceDocument, message.data).norm)


def _fingers(rr: Any, message: RawMessage) -> tuple[str, Any]:
    return FINGERS, rr.Scalars(1000 * documents.decode(GripperState, message.data).width)


def _decision(rr: Any, message: RawMessage) -> tuple[str, Any]:
    made = documents.decode(LoggedDecision, message.data)
    return TOLD, rr.TextDocument(f"decided: {telling.decision(made)}")


def _refusal(rr: Any, message: RawMessage) -> tuple[str, Any]:
    refusal = documents.decode(Refusal, message.data)
    told = f"refused: {telling.action(refusal.decision.primitive)}: {refusal.reason}"
    return TOLD, rr.TextDocument(told)


def _outcome(rr: Any, message: RawMessage) -> tuple[str, Any]:
    outcome = documents.decode(Conclusion, message.data).outcome
    told = f"{telling.WORDS[outcome.success]}: {telling.measured(outcome)}"
    return TOLD, rr.TextDocument(told)


_TOLD: dict[str, Callable[[Any, RawMessage], tuple[str, Any]]] = {
    channels.TOOL_FORCE: _force,
    channels.GRIPPER: _fingers,
    channels.DECISION: _decision,
    channels.REFUSAL: _refusal,
    channels.OUTCOME: _outcome,
}
