"""A log in Rerun: its own importer reads the images and frames; what it leaves as bytes, the
documents, are added as curves and text.
"""

from __future__ import annotations

import shutil
import sys
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

DEADLINE = 30.0  # s for the viewer to take what was sent


def write_rrd(episode: Episode, path: Path) -> None:
    """Into a file, with the blueprint. Raises ConfigError."""
    rr = _rerun()
    recording = rr.RecordingStream("tdpg-deploy")
    try:
        recording.save(path, default_blueprint=build_blueprint())
    except RuntimeError as error:
        raise ConfigError(f"--rrd {path}: cannot be written ({error})") from error
    _log(rr, recording, episode)
    recording.disconnect()


def open_in_rerun(episode: Episode) -> None:
    """In the viewer that is open, or in a new one. Raises ConfigError."""
    rr = _rerun()
    recording = rr.RecordingStream("tdpg-deploy")
    beside = shutil.which("rerun", path=Path(sys.executable).parent)  # None: Rerun searches PATH
    try:
        rr.spawn(executable_path=beside, recording=recording, default_blueprint=build_blueprint())
        _log(rr, recording, episode)
        recording.flush(timeout_sec=DEADLINE)
    except RuntimeError as error:
        raise ConfigError(
            f"--rerun: no viewer takes the episode ({error}). Without a screen, write a file with "
            "--rrd OUT.rrd"
        ) from error


def _rerun() -> Any:
    try:
        return import_module("rerun")
    except ImportError as error:
        raise ConfigError("Rerun needs rerun-sdk: pip install 'tdpg-deploy[view]'") from error


def _log(rr: Any, recording: Any, episode: Episode) -> None:
    recording.send_recording_name(episode.path.stem)
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
