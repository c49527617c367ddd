"""From a log to a row of the metrics: simulated and real runs are judged by the same code."""

from __future__ import annotations

from pathlib import Path

from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.entries import End
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import LogError
from tdpg_deploy.sim.scene_file import parse_scene
from tools.evaluate.metrics import EpisodeRow


def read_row(path: Path, *, scene: str) -> EpisodeRow:
    """What a finished episode's log says. scene: a label for the table it was played on.

    Raises LogError for a log that is damaged or has no end.
    """
    episode = read_episode(path)
    ends = [entry for entry in episode.entries(images=False) if isinstance(entry, End)]
    if not ends:
        raise LogError(f"{path}: the episode has no end: it was cut off")
    result = ends[-1].result
    about = episode.about
    return EpisodeRow(
        scene=scene,
        seed=about.seed or 0,
        reason=result.reason,
        objects=objects_of(about, result),
        actions=result.actions,
        grasps=result.grasps,
        grasp_successes=result.grasp_successes,
    )


def objects_of(about: About, result: EpisodeResult) -> int:
    """How many lay on the table at the start. On a real one nobody counts; a completed one held
    what was lifted from it."""
    return result.grasp_successes if about.scene is None else len(parse_scene(about.scene).objects)
