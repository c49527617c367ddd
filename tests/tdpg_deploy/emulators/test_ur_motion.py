"""Trajectories against closed forms, and against another library's kinematics."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ur_analytic_ik import ur5, ur5e

from tdpg_deploy.emulators.ur_controller.motion import (
    JointPath,
    LinearPath,
    OutOfReach,
    PathMotion,
    SpeedMotion,
    solve,
)
from tdpg_deploy.geometry import Array, Transform, top_down
from tdpg_deploy.kinematics import MODELS, UR5

DT = 0.008
HOME = np.radians([90, -110, 100, -80, -90, 10])
X_FLANGE_TOOL = Transform.from_rotation_vector([0, 0, 0.163, 0, 0, 0])
REFERENCES = {"ur5": ur5, "ur5e": ur5e}


def positions(motion: PathMotion, q: Array, *, slider: float = 1.0) -> Array:
    """(n, 6) joint targets until the motion is done."""
    rows = [q]
    while not motion.done:
        rows.append(motion.step(DT, slider, rows[-1]))
        assert len(rows) < 10_000
    return np.array(rows)


@settings(deadline=None)
@given(
    length=st.floats(0.01, 3.0),
    speed=st.floats(0.2, 3.0),
    acceleration=st.floats(0.5, 10.0),
)
def test_trapezoid(length: float, speed: float, acceleration: float) -> None:
    goal = HOME + np.array([length, 0, 0, 0, -length / 2, 0])
    motion = PathMotion(JointPath(HOME, goal), speed=speed, acceleration=acceleration)
    rows = positions(motion, HOME)
    np.testing.assert_allclose(rows[-1], goal, atol=1e-12)
    v = np.diff(rows[:, 0]) / DT
    assert v.max() <= speed + 1e-9
    assert np.diff(v).max() <= acceleration * DT + 1e-9
    if speed**2 / acceleration < length:
        duration = length / speed + speed / acceleration
    else:
        duration = 2 * np.sqrt(length / acceleration)
    assert (len(rows) - 1) * DT == pytest.approx(duration, abs=6 * DT)


@pytest.mark.parametrize("model", MODELS)
def test_line_is_straight_and_even(model: str) -> None:
    forward = REFERENCES[model].forward_kinematics
    start = Transform.from_matrix(forward(*HOME)) @ X_FLANGE_TOOL
    end = top_down(0.35, -0.25, 0.2, 0.5)
    path = LinearPath(start, end, partial(solve, MODELS[model], X_FLANGE_TOOL))
    rows = positions(PathMotion(path, speed=0.25, acceleration=1.2), HOME)
    poses = [Transform.from_matrix(forward(*q)) @ X_FLANGE_TOOL for q in rows]
    assert poses[-1].distance(end)[0] < 1e-6
    assert poses[-1].distance(end)[1] < 1e-6
    whole, turn = start.distance(end)
    for pose in poses:
        share, turned = np.array(start.distance(pose)) / (whole, turn)
        left = pose.distance(end)[0] / whole
        assert share + left == pytest.approx(1.0, abs=1e-6)  # else it would not be straight
        assert turned == pytest.approx(share, abs=1e-5)
    assert np.abs(np.diff(rows, axis=0)).max() < 0.05  # no change of branch


def test_turn_on_the_spot() -> None:
    start = top_down(0.35, -0.25, 0.2, 0.0)
    end = top_down(0.35, -0.25, 0.2, 0.8)
    path = LinearPath(start, end, partial(solve, UR5, X_FLANGE_TOOL))
    assert path.length == pytest.approx(0.8)


def test_braking_distance() -> None:
    path = JointPath(np.zeros(6), np.array([3.0, 0, 0, 0, 0, 0]))
    motion = PathMotion(path, speed=1.0, acceleration=5.0)
    q: Array = np.zeros(6)
    while q[0] < 1.0:
        q = motion.step(DT, 1.0, q)
    motion.brake(4.0)
    rows = positions(motion, q)
    assert rows[-1, 0] - q[0] == pytest.approx(1.0**2 / (2 * 4.0), abs=DT)
    motion.resume()
    assert positions(motion, rows[-1])[-1, 0] == pytest.approx(3.0)


@pytest.mark.parametrize("slider", [0.5, 0.1])
def test_slider_limits_the_speed(slider: float) -> None:
    path = JointPath(np.zeros(6), np.array([0.5, 0, 0, 0, 0, 0]))
    rows = positions(PathMotion(path, speed=1.0, acceleration=5.0), np.zeros(6), slider=slider)
    assert np.diff(rows[:, 0]).max() / DT == pytest.approx(slider)


def test_slider_at_zero_holds_the_arm() -> None:
    path = JointPath(np.zeros(6), np.ones(6))
    motion = PathMotion(path, speed=1.0, acceleration=5.0)
    q: Array = np.zeros(6)
    for _ in range(100):
        q = motion.step(DT, 0.0, q)
    assert not q.any()
    assert not motion.done


def test_speed_motion_ramps_and_brakes() -> None:
    wanted = np.array([0.5, -0.25, 0, 0, 0, 0])
    motion = SpeedMotion(lambda _: wanted, acceleration=1.0)
    q: Array = np.zeros(6)
    speeds = []
    for _ in range(100):
        before, q = q, motion.step(DT, 1.0, q)
        speeds.append((q - before) / DT)
    np.testing.assert_allclose(speeds[-1], wanted)
    assert np.abs(np.diff(speeds, axis=0)).max() <= 1.0 * DT + 1e-9
    motion.brake(2.0)
    while not motion.done:
        q = motion.step(DT, 1.0, q)
    np.testing.assert_allclose(motion.step(DT, 1.0, q), q)


def test_out_of_reach() -> None:
    with pytest.raises(OutOfReach, match="no joint positions"):
        solve(UR5, X_FLANGE_TOOL, top_down(1.2, 0, 0, 0), HOME)
