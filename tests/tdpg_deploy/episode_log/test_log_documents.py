"""Documents: any value comes back, any bytes end in a value or a LogError."""

from __future__ import annotations

import json
from math import nan
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_episode import Synthetic

from policies.primitives import Grasp, Push
from tdpg_deploy.episode_log import documents
from tdpg_deploy.episode_log.channels import DOCUMENTS
from tdpg_deploy.episode_log.entries import Conclusion, LoggedDecision, PlanDocument
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.errors import LogError
from tdpg_deploy.hal import GripperState, Holding
from tdpg_deploy.outcome import GraspOutcome, Motion, Outcome, PushOutcome, Verdict
from tdpg_deploy.plan import MoveLinear, Plan

numbers = st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(st.characters(exclude_categories=["C", "Z"]))  # others are replaced: see below
motions = st.builds(Motion, contact=st.none() | texts, seconds=numbers)
outcomes: st.SearchStrategy[Outcome] = st.builds(
    GraspOutcome,
    motion=motions,
    width_after_close=numbers,
    width_after_lift=numbers,
    held_by_width=st.sampled_from(Verdict),
    gone_from_map=st.sampled_from(Verdict),
) | st.builds(PushOutcome, motion=motions, travelled=numbers, changed=st.sampled_from(Verdict))


@given(outcomes, numbers)
def test_outcomes_come_back(outcome: Outcome, stamp: float) -> None:
    conclusion = Conclusion(outcome=outcome, stamp=stamp)
    assert documents.decode(Conclusion, documents.encode(conclusion)) == conclusion


counts = st.integers(0, 2**40)
COUNTS = (
    "actions",
    "grasps",
    "pushes",
    "grasp_successes",
    "push_successes",
    "delivered",
    "refused",
)


@given(st.builds(EpisodeResult, seconds=numbers, **dict.fromkeys(COUNTS, counts)))
def test_results_come_back(result: EpisodeResult) -> None:
    assert documents.decode(EpisodeResult, documents.encode(result)) == result


def test_nan_is_null_and_back() -> None:
    state = GripperState(width=nan, moving=False, holding=Holding.UNKNOWN, stamp=1.5)
    data = documents.encode(state)
    assert json.loads(data)["width"] is None
    assert documents.decode(GripperState, data).width != 0.0
    assert repr(documents.decode(GripperState, data).width) == "nan"


def test_primitives_are_told_apart_by_kind() -> None:
    push = Push(x=0.5, y=0.1, z=-0.1, yaw=0.3)
    data = documents.encode(push)
    assert json.loads(data)["kind"] == "Push"
    assert documents.decode(Push | Grasp, data) == push


def test_plans_keep_poses_and_joints() -> None:
    plan = Synthetic().plan(Grasp(x=0.5, y=0.1, z=-0.1, yaw=0.3))
    back = documents.decode(Plan, documents.encode(plan))
    above, above_back = plan.approach[0], back.approach[0]
    assert isinstance(above, MoveLinear)
    assert isinstance(above_back, MoveLinear)
    assert above_back.X_base_tool.distance(above.X_base_tool) < (1e-15, 1e-7)
    assert above_back.stop_force is None
    assert back.notes == plan.notes


def test_neighbouring_versions_read_each_other() -> None:
    newer = {"x": 0.1, "y": 0.2, "z": 0.3, "yaw": 0.4, "speed": 9}  # no length, a new field
    assert documents.decode(Push, json.dumps(newer).encode()) == Push(x=0.1, y=0.2, z=0.3, yaw=0.4)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff",
        b"[]",
        b"{}",
        b'{"width": "wide", "moving": false, "holding": "nothing", "stamp": 1}',
        b'{"width": 1, "moving": 0, "holding": "nothing", "stamp": 1}',
        b'{"width": 1, "moving": false, "holding": "perhaps", "stamp": 1}',
        b'{"width": true, "moving": false, "holding": "nothing", "stamp": 1}',
        b'{"width": 1' + b"0" * 400 + b', "moving": false, "holding": "nothing", "stamp": 1}',
        b"[" * 100_000,
    ],
)
def test_wrong_documents_are_log_errors(data: bytes) -> None:
    with pytest.raises(LogError, match="not a GripperState document"):
        documents.decode(GripperState, data)


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("öffnen\t→ 3\n", "öffnen\t→ 3\n"),
        ("\x1b[2J\x07\x00", "\ufffd[2J\ufffd\ufffd"),
        ("\u202e\ud800", "\ufffd\ufffd"),
    ],
)
def test_what_a_terminal_would_obey_is_replaced(written: str, read: str) -> None:
    assert documents.text(written) == read


def test_a_text_without_end_is_refused() -> None:
    document = {"kind": "Motion", "contact": "x" * 100_001, "seconds": 1.0}
    with pytest.raises(LogError, match="a text of 100001 characters"):
        documents.decode(Motion, json.dumps(document).encode())


json_values: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | numbers | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.sampled_from(list(DOCUMENTS.values())), st.data())
def test_any_json_is_a_value_or_a_log_error(kind: Any, data: st.DataObject) -> None:
    names = st.sampled_from(["kind", *kind.__dataclass_fields__])
    document = data.draw(st.dictionaries(names, json_values) | json_values)
    try:
        value = documents.decode(kind, json.dumps(document).encode())
    except LogError:
        return
    assert isinstance(value, kind)


def test_decision_sums_up_its_maps() -> None:
    synthetic = Synthetic()
    decision = synthetic.decision(synthetic.blocks(2), push=True)
    logged = LoggedDecision.of(decision)
    assert len(logged.pushes) == 16
    assert [candidate.rotation for candidate in logged.grasps] == [
        k for k in range(16) if k != 3  # no grasp is allowed there
    ]  # fmt: skip
    best = max(logged.pushes, key=lambda candidate: candidate.q)
    assert (best.rotation, best.row, best.col) == (decision.rotation, decision.row, decision.col)
    decision.maps.grasp[0, 100, 100] += 1e-6
    assert LoggedDecision.of(decision).maps_sha256 != logged.maps_sha256


@pytest.mark.parametrize("kind", DOCUMENTS.values())
def test_schemas_name_every_field(kind: Any) -> None:
    schema = json.loads(documents.schema(kind))
    assert schema["title"] == kind.__name__
    assert schema["properties"].keys() == {"kind", *kind.__dataclass_fields__}


def test_schema_of_a_plan_reaches_its_steps() -> None:
    schema = json.loads(documents.schema(PlanDocument))
    steps = schema["properties"]["plan"]["properties"]["approach"]["items"]["anyOf"]
    assert [step["title"] for step in steps] == ["MoveJoints", "MoveLinear", "MoveFingers"]
