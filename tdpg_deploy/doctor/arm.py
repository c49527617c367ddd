"""Is the controller there, new enough, ready to move, and does it speak often enough?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tdpg_deploy.cell_config import ArmSection
from tdpg_deploy.doctor.finding import Finding, judge
from tdpg_deploy.doctor.rtde_watch import Listening, listen
from tdpg_deploy.drivers.ur5_network import (
    ask_model,
    ask_modes,
    ask_remote_control,
    ask_version,
    check_script_port,
)
from tdpg_deploy.drivers.ur5_status import (
    MIN_SLIDER,
    ControllerVersion,
    RobotMode,
    SafetyMode,
    safety_problem,
)
from tdpg_deploy.kinematics import MODELS, DhParameters

ARM = "arm"
LATE = 5  # periods between two states


def examine_arm(section: ArmSection) -> Iterator[Finding]:
    """Findings, or DeviceError when it does not answer. Starts no program on the controller."""
    version = ask_version(section.host)
    yield judge(
        ARM,
        "controller",
        f"PolyScope {version} at {section.host}",
        good=version.is_supported,
        bad=True,
        remedy="update PolyScope to 3.4, or 5.4 on an e-series",
    )
    yield judge_model(ask_model(section.host, version), section.dh)
    yield from _modes(section.host)
    if version.has_remote_control:
        yield judge(
            ARM,
            "remote control",
            "on" if (remote := ask_remote_control(section.host)) else "off",
            good=remote,
            bad=True,
            remedy="switch the pendant to remote control (top right)",
        )
    check_script_port(section.host)
    yield judge(ARM, "programs", "can be sent", good=True, remedy="")
    rate = _rate(version)
    heard = listen(section.host, rate=rate)
    yield judge_rate(heard, rate)
    yield judge_slider(heard.slider)
    yield judge(ARM, "joints", _degrees(heard.q), good=True, remedy="")


def _modes(host: str) -> Iterator[Finding]:
    robot, safety = ask_modes(host)
    problem = safety_problem(robot, safety)
    yield judge(
        ARM,
        "mode",
        f"{RobotMode(robot).name}, safety {SafetyMode(safety).name}",
        good=problem is None,
        bad=True,
        remedy=str(problem),
    )


def judge_model(told: str | None, expected: DhParameters) -> Finding:
    """In doubt where an old controller does not tell; the driver looks at tool poses, too."""
    if told is None:
        remedy = f"make sure that the arm is a {expected.name}, else change arm.model"
    elif told.lower() in MODELS:
        remedy = f'set arm.model = "{told.lower()}", and see that arm.home suits it'
    else:
        remedy = f"use one of {', '.join(dh.name for dh in MODELS.values())}"
    good, bad = told == expected.name, told is not None
    return judge(ARM, "model", told or "not told", good=good, bad=bad, remedy=remedy)


def judge_rate(heard: Listening, rate: float) -> Finding:
    return judge(
        ARM,
        "states",
        f"{heard.rate:.0f} a second, longest gap {heard.longest_gap * 1e3:.0f} ms",
        good=heard.rate > 0.9 * rate and heard.longest_gap < LATE / rate,
        remedy="a cable straight to the controller, no wireless link in between",
    )


def judge_slider(slider: float) -> Finding:
    return judge(
        ARM,
        "speed slider",
        f"{slider:.0%}",
        good=slider > 0.99,
        bad=slider < MIN_SLIDER,
        remedy="raise it at the pendant: motions take longer than planned, or never end",
    )


def _rate(version: ControllerVersion) -> float:
    """States a second that the controller can send at most."""
    return 500.0 if version.major >= 5 else 125.0


def _degrees(q: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{angle:.1f}" for angle in np.degrees(q)) + "] degrees"
