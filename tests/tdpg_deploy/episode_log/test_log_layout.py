"""The Foxglove layout shows channels that exist, and every panel has its place."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import pytest

from tdpg_deploy.episode_log.channels import BASE, DOCUMENTS, PROTOBUF

LAYOUT = json.loads(
    (files("tdpg_deploy") / "episode_log" / "layouts" / "foxglove.json").read_text("utf-8")
)
PANELS = {"3D", "Image", "Plot", "RosOut", "RawMessages"}  # of Foxglove and Lichtblick


def leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
        return
    assert node.keys() <= {"direction", "first", "second", "splitPercentage"}
    assert node["direction"] in {"row", "column"}
    assert 0 < node["splitPercentage"] < 100
    yield from leaves(node["first"])
    yield from leaves(node["second"])


def values_of(node: Any, *keys: str) -> Iterator[str]:
    if isinstance(node, dict):
        for key, value in node.items():
            if key in keys:
                yield value
            yield from values_of(value, *keys)
    elif isinstance(node, list):
        for value in node:
            yield from values_of(value, *keys)


def test_every_panel_has_one_place() -> None:
    placed = list(leaves(LAYOUT["layout"]))
    assert len(placed) == len(set(placed))
    assert set(placed) == set(LAYOUT["configById"])
    assert {panel.split("!")[0] for panel in placed} == PANELS


def test_the_keys_of_a_layout() -> None:
    assert LAYOUT.keys() == {
        "configById", "globalVariables", "userNodes", "playbackConfig", "layout",
    }  # fmt: skip


def test_panels_show_channels_that_exist() -> None:
    topics = PROTOBUF.keys() | DOCUMENTS.keys()
    keys = ("imageTopic", "calibrationTopic", "topicPath", "topicToRender")
    shown = set(values_of(LAYOUT["configById"], *keys))
    drawn = set(LAYOUT["configById"]["3D!cell"]["topics"])
    assert shown | drawn <= topics
    assert LAYOUT["configById"]["3D!cell"]["followTf"] == BASE


@pytest.mark.parametrize("path", [*values_of(LAYOUT["configById"], "value")])
def test_plots_follow_fields_that_exist(path: str) -> None:
    topic, field = path.split(".")
    assert field in DOCUMENTS[topic].__dataclass_fields__
