"""The controller's states without sockets: programs, stops, watchdog; dashboard and RTDE words."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from tdpg_deploy.emulators.ur_controller import dashboard
from tdpg_deploy.emulators.ur_controller import rtde_wire as wire
from tdpg_deploy.emulators.ur_controller.controller import Controller, Refused
from tdpg_deploy.emulators.ur_controller.modes import (
    CONTROLLERS,
    RobotMode,
    RuntimeState,
    SafetyMode,
)
from tdpg_deploy.emulators.ur_controller.plant import KinematicPlant
from tdpg_deploy.emulators.ur_controller.rtde_session import Claims, RtdeSession
from tdpg_deploy.emulators.ur_controller.rtde_wire import Kind, Package, WireError, split
from tdpg_deploy.kinematics import MODELS

HOME = np.radians([90.0, -110, 100, -80, -90, 0])
MOVE = "def move():\n  movej([1, -1.9, 1.7, -1.4, -1.6, 0], a=2.0, v=0.5)\nend\n"
IDLE = "def idle():\n  while True:\n    sync()\n  end\nend\n"


@pytest.fixture(params=MODELS)
def controller(request: pytest.FixtureRequest) -> Controller:
    return controller_of(request.param)


def controller_of(model: str, *, table_z: float | None = None) -> Controller:
    plant = KinematicPlant(MODELS[model], HOME, table_z=table_z)
    return Controller(plant, CONTROLLERS[model])


def pass_time(controller: Controller, seconds: float) -> None:
    for _ in range(round(seconds * controller.generation.frequency)):
        controller.cycle()


def moving(controller: Controller) -> Controller:
    controller.upload(MOVE)
    pass_time(controller, 0.4)
    assert controller.is_moving
    return controller


# --- programs and safety ----------------------------------------------------------------------


def test_program_moves_the_arm_and_ends(controller: Controller) -> None:
    moving(controller)
    pass_time(controller, 2.0)
    assert controller.q[0] == pytest.approx(1.0)
    assert controller.runtime is RuntimeState.STOPPED


@pytest.mark.parametrize("how", ["stop_program", "protective_stop", "power_off"])
def test_arm_comes_to_rest(controller: Controller, how: str) -> None:
    moving(controller)
    {
        "stop_program": controller.stop_program,
        "protective_stop": lambda: controller.protective_stop("test"),
        "power_off": controller.power_off,
    }[how]()
    pass_time(controller, 0.3)
    assert not controller.is_moving
    assert controller.q[0] > 1.1


def test_protective_stop_is_unlocked_after_five_seconds(controller: Controller) -> None:
    moving(controller).protective_stop("test")
    assert controller.runtime is RuntimeState.PAUSED
    pass_time(controller, 4.9)
    with pytest.raises(Refused, match="until 5s after occurrence"):
        controller.unlock_protective_stop()
    with pytest.raises(Refused, match="play"):
        controller.play()
    pass_time(controller, 0.2)
    controller.unlock_protective_stop()
    assert controller.safety is SafetyMode.NORMAL


def test_play_after_a_stop_resumes_the_motion(controller: Controller) -> None:
    """The hazard that drivers have to know of."""
    moving(controller).protective_stop("test")
    pass_time(controller, 5.1)
    controller.unlock_protective_stop()
    controller.play()
    pass_time(controller, 2.0)
    assert controller.q[0] == pytest.approx(1.0)


def test_safeguard_stop_resumes_by_itself(controller: Controller) -> None:
    moving(controller).safeguard_stop()
    pass_time(controller, 1.0)
    assert not controller.is_moving
    controller.release_stop()
    pass_time(controller, 0.2)
    assert controller.is_moving


def test_emergency_stop_needs_power_and_brakes(controller: Controller) -> None:
    moving(controller).emergency_stop()
    controller.power_on()
    assert controller.mode is RobotMode.POWER_OFF
    controller.release_stop()
    controller.power_on()
    controller.release_brakes()
    assert controller.is_ready
    assert controller.runtime is RuntimeState.STOPPED


def test_watchdog_stops_the_program(controller: Controller) -> None:
    controller.upload(IDLE)
    controller.set_watchdog("input_int_register_0", 10.0)
    for _ in range(20):
        pass_time(controller, 0.04)
        controller.write_inputs({"input_int_register_0": 0})
    assert controller.runtime.name == "PLAYING"
    pass_time(controller, 0.12)
    assert controller.runtime.name == "STOPPED"


def test_script_errors_end_the_program(controller: Controller) -> None:
    for program in (
        "def far():\n  movel(p[2, 0, 0, 0, 0, 0])\nend\n",
        "def unknown():\n  make_coffee()\nend\n",
        "movej([0])\n",
    ):
        controller.upload(program)
        pass_time(controller, 0.1)
        assert controller.runtime is RuntimeState.STOPPED
        assert not controller.is_moving


def test_servoing_follows_late_by_the_lookahead_time(controller: Controller) -> None:
    """A ramp is followed by speed times lookahead, and its end exponentially."""
    controller.upload(
        "def servo():\n"
        "  i = 0\n"
        "  while True:\n"
        "    servoj([1.5708 + 0.002 * i, -1.92, 1.745, -1.396, -1.5708, 0], t=0.008, "
        "lookahead_time=0.1, gain=300)\n"
        "    if i < 200:\n"
        "      i = i + 1\n"
        "    end\n"
        "  end\n"
        "end\n"
    )
    pass_time(controller, 1.6)
    end = 1.5708 + 0.002 * 200
    assert end - controller.q[0] == pytest.approx(0.25 * 0.1, rel=0.1)
    pass_time(controller, 0.2)
    assert end - controller.q[0] == pytest.approx(0.25 * 0.1 * np.exp(-2), rel=0.2)
    controller.stop_program()
    pass_time(controller, 0.1)
    assert not controller.is_moving


def test_a_servo_target_that_jumps_ends_in_a_protective_stop(controller: Controller) -> None:
    controller.upload("def jump():\n  servoj([2.5, -1.92, 1.745, -1.396, -1.57, 0], t=0.5)\nend\n")
    pass_time(controller, 0.5)
    assert controller.safety is SafetyMode.PROTECTIVE_STOP


def test_what_is_not_emulated_is_refused_by_name(
    controller: Controller, caplog: pytest.LogCaptureFixture
) -> None:
    controller.upload("def soft():\n  force_mode(p[0,0,0,0,0,0], [0], [0], 2, [0])\nend\n")
    pass_time(controller, 0.1)
    assert controller.runtime is RuntimeState.STOPPED
    assert "soft: force_mode is not emulated; docs/emulate.md says what is" in caplog.text


def test_scripts_are_ignored_while_the_arm_cannot_move(controller: Controller) -> None:
    controller.set_remote(False)
    controller.upload(IDLE)
    controller.set_remote(True)
    controller.power_off()
    controller.upload(IDLE)
    assert controller.runtime is RuntimeState.STOPPED


def test_singular_line_ends_in_a_protective_stop(controller: Controller) -> None:
    """Out of reach half-way: from one side of the base to the other, through its axis."""
    controller.upload(
        "def through():\n"
        "  movej([0.1, -1.9, 1.7, -1.4, -1.6, 0], a=9, v=3)\n"
        "  t = get_actual_tcp_pose()\n"
        "  movel(p[-t[0], -t[1], t[2], t[3], t[4], t[5]], a=9, v=2)\n"
        "end\n"
    )
    pass_time(controller, 3.0)
    assert controller.safety is SafetyMode.PROTECTIVE_STOP


def test_forces_beyond_the_limit_end_in_a_protective_stop() -> None:
    controller = controller_of("ur5", table_z=0.2)
    controller.upload(
        "def press():\n"
        "  t = get_actual_tcp_pose()\n"
        "  movel(p[t[0], t[1], t[2] - 0.3, t[3], t[4], t[5]], a=1, v=0.1)\n"
        "end\n"
    )
    pass_time(controller, 4.0)
    assert controller.safety is SafetyMode.PROTECTIVE_STOP
    assert controller.force[2] > 150


# --- dashboard --------------------------------------------------------------------------------


def test_dashboard_follows_the_state(controller: Controller) -> None:
    def ask(command: str) -> str:
        return dashboard.answer(command + "\n", controller)

    assert ask("robotmode") == "Robotmode: RUNNING"
    assert ask("running") == "Program running: false"
    controller.upload(IDLE)
    assert ask("programState") == "PLAYING idle"
    assert ask("play") == "Failed to execute: play"
    assert ask("pause") == "Pausing program"
    assert ask("play") == "Starting program"
    controller.protective_stop("test")
    assert ask("safetymode") == "Safetymode: PROTECTIVE_STOP"
    assert ask("unlock protective stop").startswith("Cannot unlock protective stop until 5s")
    assert ask("stop") == "Stopped"
    assert ask("power off") == "Powering off"
    assert ask("robotmode") == "Robotmode: POWER_OFF"
    assert ask("make coffee") == 'could not understand: "make coffee"'


def test_dashboard_of_each_generation() -> None:
    cb3, e_series = controller_of("ur5"), controller_of("ur5e")
    assert "3.15.8.106339" in dashboard.answer("PolyscopeVersion", cb3)
    assert dashboard.answer("is in remote control", cb3).startswith("could not understand")
    assert dashboard.answer("is in remote control", e_series) == "true"
    assert dashboard.answer("get serial number", e_series).isdigit()
    e_series.set_remote(False)
    assert dashboard.answer("stop", e_series) == dashboard.NOT_REMOTE
    cb3.set_remote(False)
    assert dashboard.answer("stop", cb3) == "Stopped"


# --- RTDE sessions ----------------------------------------------------------------------------


def request(session: RtdeSession, kind: str, payload: bytes = b"") -> bytes:
    """The reply's payload."""
    packages, left = split(session.answer(Package(kind=ord(kind), payload=payload)))
    assert left == b""
    assert [package.kind for package in packages] == [ord(kind)]
    return packages[0].payload


def test_outputs_come_at_the_rate_asked_for() -> None:
    controller = controller_of("ur5e")
    session = RtdeSession(controller, Claims())
    assert request(session, "V", b"\x00\x02") == b"\x01"
    assert request(session, "V", b"\x00\x01") == b"\x00"
    assert request(session, "v") == struct.pack(">4I", 5, 11, 1, 108318)
    assert request(session, "S") == b"\x00"  # nothing is set up yet
    recipe = request(session, "O", struct.pack(">d", 125.0) + b"timestamp,actual_q,runtime_state,")
    assert recipe == b"\x01DOUBLE,VECTOR6D,UINT32"
    assert session.due() == b""
    assert request(session, "S") == b"\x01"
    received = []
    for _ in range(500):
        controller.cycle()
        received.append(session.due())
    packages = [data for data in received if data]
    assert len(packages) in (125, 126)
    size, kind, recipe_id, timestamp, *q, runtime = struct.unpack(">HBBd6dI", packages[-1])
    assert (size, kind, recipe_id) == (len(packages[-1]), ord("U"), 1)
    assert timestamp == pytest.approx(controller.time, abs=0.01)
    np.testing.assert_allclose(q, HOME)
    assert runtime == 1
    assert request(session, "P") == b"\x01"
    controller.cycle()
    assert session.due() == b""


def test_unknown_variables_and_rates_are_not_found(controller: Controller) -> None:
    session = RtdeSession(controller, Claims())
    rate = struct.pack(">d", 125.0)
    assert request(session, "O", rate + b"timestamp,coffee") == b"\x00DOUBLE,NOT_FOUND"
    assert request(session, "O", struct.pack(">d", 1e4) + b"timestamp") == b"\x00DOUBLE"
    assert request(session, "I", b"input_int_register_0,coffee") == b"\x00INT32,NOT_FOUND"
    assert request(session, "I", b"input_int_register_48") == b"\x00NOT_FOUND"
    wrench = request(session, "O", rate + b"ft_raw_wrench")
    expected = b"\x01VECTOR6D" if controller.generation.version[0] == 5 else b"\x00NOT_FOUND"
    assert wrench == expected


def test_an_input_has_one_writer(controller: Controller) -> None:
    claims = Claims()
    first, second = RtdeSession(controller, claims), RtdeSession(controller, claims)
    names = b"input_int_register_0,input_double_register_1"
    assert request(first, "I", names) == b"\x01INT32,DOUBLE"
    assert request(first, "I", b"input_int_register_0") == b"\x02INT32"
    assert request(second, "I", names + b",input_int_register_7") == (b"\x00IN_USE,IN_USE,INT32")
    first.answer(Package(kind=ord("U"), payload=struct.pack(">Bid", 1, -5, 0.5)))
    assert controller.inputs == {"input_int_register_0": -5, "input_double_register_1": 0.5}
    first.close()
    assert request(second, "I", names) == b"\x01INT32,DOUBLE"
    controller.claimed_by_fieldbus = frozenset({"input_int_register_1"})
    assert request(second, "I", b"input_int_register_1") == b"\x00IN_USE"


def test_nonsense_ends_a_session(controller: Controller) -> None:
    session = RtdeSession(controller, Claims())
    for kind, payload in ((ord("x"), b""), (Kind.DATA, b"\x01\x00"), (Kind.DATA, b"")):
        with pytest.raises(WireError):
            session.answer(Package(kind=kind, payload=payload))
    assert wire.HEADER.size == 3
