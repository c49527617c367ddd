"""The head of a log tells exactly how the episode came to be."""

from __future__ import annotations

import platform
import sys
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis.extra import numpy as hnp
from hypothesis.strategies import floats
from synthetic_episode import ABOUT

from tdpg_deploy.cell_config import Pose
from tdpg_deploy.episode_log import about as head
from tdpg_deploy.episode_log.about import CELL, SCENE, About
from tdpg_deploy.episode_log.software import commit, processor_of, versions
from tdpg_deploy.errors import LogError


def again(about: About) -> About:
    attachments = {CELL: head.cell_attachment(about.cell)}
    if about.scene is not None:
        attachments[SCENE] = about.scene.encode()
    return head.from_metadata(head.to_metadata(about, 12), about.versions, attachments)


def test_everything_comes_back() -> None:
    assert again(ABOUT) == ABOUT


def test_what_is_unknown_stays_unknown() -> None:
    bare = About(cell=ABOUT.cell, policy="random", started_at=0.1 + 0.2)
    assert again(bare) == bare


@given(hnp.arrays(np.float64, 4, elements=floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_poses_of_a_cell_come_back_to_the_last_bit(q: npt.NDArray[np.float64]) -> None:
    """A heightmap made again from a logged frame depends on them."""
    x, y, z, w = (q / np.linalg.norm(q)).round(7).tolist()
    camera = ABOUT.cell.camera.model_copy(
        update={"X_base_camera": Pose(position=(0.7, 0.1, 0.6), quaternion=(x, y, z, w))}
    )
    about = replace(ABOUT, cell=ABOUT.cell.model_copy(update={"camera": camera}))
    assert again(about) == about


@pytest.mark.parametrize(
    ("metadata", "attachments", "reason"),
    [
        ({}, {}, "without a schema version"),
        ({"schema_version": "-1"}, {}, "without a schema version"),
        ({"schema_version": "2"}, {}, "newer than 1"),
        ({"schema_version": "9" * 5000}, {}, "cannot be read"),
        ({"schema_version": "1"}, {}, "'cell.json' is missing"),
        ({"schema_version": "1"}, {CELL: b"{"}, "cannot be read"),
        ({"schema_version": "1"}, {CELL: b"[1]"}, "cannot be read"),
        ({"schema_version": "1"}, {CELL: b"[" * 100_000}, "cannot be read"),
        (
            {"schema_version": "1", "policy": "light", "started_at": "noon"},
            {CELL: head.cell_attachment(ABOUT.cell)},
            "noon",
        ),
        (
            {"schema_version": "1", "policy": "light", "started_at": "1e300"},
            {CELL: head.cell_attachment(ABOUT.cell)},
            "1e\\+300 is not between",
        ),
        (
            {"schema_version": "1", "policy": "light", "started_at": "0", "seed": "9" * 4000},
            {CELL: head.cell_attachment(ABOUT.cell)},
            "cannot be read",
        ),
    ],
)
def test_a_head_that_cannot_be_read(
    metadata: dict[str, str], attachments: dict[str, bytes], reason: str
) -> None:
    with pytest.raises(LogError, match=reason):
        head.from_metadata(metadata, {}, attachments)


def test_versions_name_what_runs() -> None:
    found = versions()
    assert found["python"] == sys.version.split()[0]
    assert found["numpy"] == np.__version__
    assert all(found.values())


def test_processors_of_one_name_are_told_apart() -> None:
    one = "processor: 0\nmodel name\t: AMD EPYC\ncpu family\t: 25\nmodel\t: 17\nflags\t: fpu avx2"
    assert processor_of(f"{one} avx512_bf16\n\nprocessor: 1\nmodel: 9") == (
        "AMD EPYC, cpu family 25, model 17, avx2, avx512_bf16"
    )
    assert processor_of(one) != processor_of(one.replace("17", "1"))
    assert processor_of("processor: 0\nBogoMIPS: 50\n") == platform.machine()


def test_commit_is_a_hash_or_unknown() -> None:
    found = commit()
    assert found is None or len(found.removesuffix("-dirty")) == 40
