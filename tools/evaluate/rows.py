"""From a log to a row of the metrics: simulated and real runs are judged by the same code."""

from __future__ import annotations

from pathlib import Path

from tdpg_deploy.episode_log.about import About
from tdpg_deploy.episode_log.entries import Conclusion, End, Look
from tdpg_deploy.episode_log.reader import Episode, read_episode
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import LogError
from tdpg_deploy.outcome import GraspOutcome, Verdict
from tdpg_deploy.sim.scene_file import parse_scene
from tools.evaluate.metrics import EpisodeRow


def read_row(path: Path, *, scene: str) -> EpisodeRow:
    """What a finished episode's log says. scene: a label for the table it was played on.

    Raises LogError for a log that is damaged or has no end.
    """
    episode = read_episode(path)
    lifted = []
    result = None
    for entry in episode.entries(images=False, states=False):
        if isinstance(entry, Conclusion):
            outcome = entry.outcome
            lifted.append(isinstance(outcome, GraspOutcome) and outcome.success is Verdict.YES)
        elif isinstance(entry, End):
            result = entry.result
    if result is None:
        raise LogError(f"{path}: the episode has no end: it was cut off")
    if len(lifted) != result.actions:
        raise LogError(f"{path}: it tells {len(lifted)} outcomes of {result.actions} actions")
    goal = had_goal(episode)
    return EpisodeRow(
        scene=scene,
        seed=episode.about.seed or 0,
        reason=result.reason,
        goal=goal,
        objects=1 if goal else objects_of(episode.about, result),
        actions=result.actions,
        grasps=result.grasps,
        grasp_successes=result.grasp_successes,
        lifted=tuple(lifted),
    )


def had_goal(episode: Episode) -> bool:
    """Whether one object was to be fetched: its pixels are in every heightmap then."""
    looks = (entry for entry in episode.entries(states=False) if isinstance(entry, Look))
    first = next(looks, None)
    return first is not None and first.heightmap.goal is not None


def objects_of(about: About, result: EpisodeResult) -> int:
    """How many lay on the table at the start. On a real one nobody counts; a completed one held
    what was lifted from it."""
    return result.grasp_successes if about.scene is None else len(parse_scene(about.scene).objects)
