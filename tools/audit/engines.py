"""The same work on many tasks, by processes of this machine or by Ray. Results come in order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from enum import Enum
from typing import Any, TypeVar

from tdpg_deploy.errors import ConfigError
from tools.pool import process_pool

AHEAD = 4  # tasks in the works or waiting, for each worker: memory does not grow with their number

T = TypeVar("T")
R = TypeVar("R")


class Engine(Enum):
    PROCESSES = "processes"
    RAY = "ray"


def in_parallel(
    work: Callable[[T], R], tasks: Iterable[T], *, workers: int, engine: Engine
) -> Iterator[R]:
    """`work` is a function of a module. Raises ConfigError where the engine is not installed."""
    if engine is Engine.RAY:
        return _by_ray(work, tasks, workers)
    return map(work, tasks) if workers == 1 else _by_processes(work, tasks, workers)


def _by_processes(work: Callable[[T], R], tasks: Iterable[T], workers: int) -> Iterator[R]:
    with process_pool(workers) as pool:
        try:
            yield from _in_order(
                lambda task: pool.submit(work, task), Future.result, tasks, AHEAD * workers
            )
        except BrokenProcessPool as error:
            raise ConfigError(
                "a working process was killed, by somebody or for want of memory: "
                "try again with fewer --workers"
            ) from error


def _by_ray(work: Callable[[T], R], tasks: Iterable[T], workers: int) -> Iterator[R]:
    """On the cluster that RAY_ADDRESS names, whose machines see the same files; else here."""
    try:
        import ray
    except ModuleNotFoundError as error:
        raise ConfigError("--engine ray: pip install 'tdpg-deploy[ray]'") from error
    here = {} if "RAY_ADDRESS" in os.environ else {"num_cpus": workers, "include_dashboard": False}
    with ray.init(log_to_driver=False, **here):
        yield from _in_order(ray.remote(work).remote, ray.get, tasks, AHEAD * workers)


def _in_order(
    submit: Callable[[T], Any], result: Callable[[Any], R], tasks: Iterable[T], ahead: int
) -> Iterator[R]:
    waiting: deque[Any] = deque()
    for task in tasks:
        waiting.append(submit(task))
        if len(waiting) >= ahead:
            yield result(waiting.popleft())
    while waiting:
        yield result(waiting.popleft())
