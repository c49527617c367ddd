"""The driver's behaviour, the same on every wire, against the emulated gripper."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from pydantic import ValidationError
from robotiq_on_wires import WIRES, Bench, bench_on, wire_to
from ur_rig import PacedClock

from tdpg_deploy.cell_config import GripperSection
from tdpg_deploy.drivers.robotiq import RobotiqGripper, robotiq_gripper
from tdpg_deploy.drivers.robotiq_registers import CountScale
from tdpg_deploy.emulators.robotiq import FaultCode
from tdpg_deploy.errors import DeviceTimeout, DeviceUnreachable, GripperError
from tdpg_deploy.hal import Holding

COUNT = 0.085 / 225  # m


@pytest.fixture(params=WIRES)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    with bench_on(request.param) as bench:
        bench.gripper.connect()
        yield bench


@pytest.fixture
def active(bench: Bench) -> Bench:
    bench.gripper.activate()
    return bench


def test_connecting_moves_nothing(bench: Bench) -> None:
    assert bench.gripper.state().holding is Holding.UNKNOWN
    assert bench.jaws.state().width == 0.085
    assert not bench.gripper.status().activated


def test_activation_travels_once(bench: Bench) -> None:
    bench.gripper.activate()
    assert bench.gripper.status().is_ready
    before = bench.clock.now()
    bench.gripper.activate()
    assert bench.clock.now() - before < 2 * 0.085 / 0.150  # no second journey


def test_moves_end_where_asked(active: Bench) -> None:
    for width in (0.020, 0.060, 0.0, 0.085):
        state = active.gripper.move(width, speed=0.15, force=20.0)
        assert state.width == pytest.approx(width, abs=COUNT)
        assert not state.moving
        assert state.holding is Holding.NOTHING


def test_an_object_between_the_pads_is_held(active: Bench) -> None:
    active.span = (0.030, 0.085)
    state = active.gripper.move(0.0, speed=0.15, force=40.0)
    assert state.width == pytest.approx(0.030, abs=COUNT)
    assert state.holding is Holding.OBJECT
    assert active.jaws.force == pytest.approx(40.0, abs=215 / 255)


def test_a_lost_object_is_noticed(active: Bench) -> None:
    active.span = (0.030, 0.085)
    active.gripper.move(0.0, speed=0.15, force=40.0)
    active.span = (0.0, 0.085)
    before = active.clock.now()
    while (state := active.gripper.state()).moving or state.holding is Holding.OBJECT:
        assert active.clock.now() < before + 2.0
    assert state.holding is Holding.NOTHING
    assert state.width < 0.001


def test_a_contact_while_opening_is_no_grasp(active: Bench) -> None:
    active.gripper.move(0.020, speed=0.15, force=20.0)
    active.span = (0.0, 0.040)
    state = active.gripper.move(0.085, speed=0.15, force=20.0)
    assert state.width == pytest.approx(0.040, abs=COUNT)
    assert state.holding is Holding.UNKNOWN


def test_an_end_of_the_last_motion_is_not_taken_for_that_of_the_next(active: Bench) -> None:
    active.model.contact_latency = 0.045
    state = active.gripper.move(0.010, speed=0.15, force=20.0)
    assert state.width == pytest.approx(0.010, abs=COUNT)


def test_asking_for_the_same_width_again_ends_at_once(active: Bench) -> None:
    for _ in range(3):
        assert active.gripper.move(0.050, speed=0.15, force=20.0).width == pytest.approx(
            0.050, abs=COUNT
        )


def test_widths_follow_the_calibrated_counts(active: Bench) -> None:
    wire = active.gripper._wire
    scale = CountScale(open_counts=13, closed_counts=218, max_width=0.080)
    gripper = RobotiqGripper(wire, clock=active.clock, scale=scale)
    assert gripper.max_width == 0.080
    gripper.move(0.040, speed=0.15, force=20.0)
    assert abs(gripper.status().position - (13 + 218) / 2) <= 0.5


def test_no_move_without_activation(bench: Bench) -> None:
    with pytest.raises(GripperError, match="not activated"):
        bench.gripper.move(0.0, speed=0.1, force=20.0)
    assert bench.jaws.state().width == 0.085


def test_a_move_out_of_time_is_stopped(active: Bench) -> None:
    with pytest.raises(DeviceTimeout, match=r"on the way to 0\.0 mm"):
        active.gripper.move(0.0, speed=0.02, force=20.0, deadline=0.5)
    assert_stopped(active)


def test_an_interrupted_move_is_stopped(active: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(active.clock, "sleep", interrupt)
        with pytest.raises(KeyboardInterrupt):
            active.gripper.move(0.0, speed=0.02, force=20.0)
    assert_stopped(active)


def test_stopping_does_not_activate_a_gripper_that_lost_its_power(active: Bench) -> None:
    sleep = active.clock.sleep

    def blink(seconds: float) -> None:
        active.model.cut_power()
        active.model.restore_power()
        sleep(seconds)

    active.clock.sleep = blink  # type: ignore[method-assign]
    with pytest.raises(GripperError, match="not activated"):
        active.gripper.move(0.0, speed=0.02, force=20.0)
    assert not active.gripper.status().activated
    assert not active.jaws.state().moving


def test_activation_mends_major_faults(active: Bench) -> None:
    active.model.fail(FaultCode.OVERCURRENT)
    with pytest.raises(GripperError, match=r"0x0E OVERCURRENT.*activate again"):
        active.gripper.state()
    active.gripper.activate()
    assert active.gripper.move(0.05, speed=0.15, force=20.0).holding is Holding.NOTHING


def test_a_failed_activation_is_stopped(bench: Bench) -> None:
    sleep = bench.clock.sleep

    def fail(seconds: float) -> None:
        if bench.jaws.state().width < 0.06:
            bench.model.fail(FaultCode.ACTIVATION)
        sleep(seconds)

    bench.clock.sleep = fail  # type: ignore[method-assign]
    with pytest.raises(GripperError, match="0x0D ACTIVATION_FAILED"):
        bench.gripper.activate()
    bench.clock.sleep = sleep  # type: ignore[method-assign]
    assert not bench.gripper.status().activated
    assert_stopped(bench)


def test_activation_waits_for_an_automatic_release(active: Bench) -> None:
    active.gripper.move(0.04, speed=0.15, force=20.0)
    active.model.release_automatically()
    active.gripper.activate()
    assert active.gripper.status().is_ready


def test_silence_while_idle_is_not_a_failure(active: Bench) -> None:
    active.clock.sleep(1.5)
    assert active.gripper.state().width == pytest.approx(0.085)
    active.clock.sleep(1.5)
    active.gripper.move(0.05, speed=0.15, force=20.0)


def test_closing_twice_and_connecting_again(active: Bench) -> None:
    active.gripper.close()
    active.gripper.close()
    with pytest.raises(DeviceUnreachable, match=r"not connected; call connect\(\)"):
        active.gripper.state()
    active.gripper.connect()
    active.gripper.connect()
    assert active.gripper.state().width == pytest.approx(0.085)


@pytest.mark.parametrize(
    ("section", "name"),
    [
        ({"driver": "robotiq_rtu", "port": "/dev/ttyUSB0"}, "gripper on /dev/ttyUSB0"),
        ({"driver": "robotiq_rtu_tcp"}, "gripper at 10.0.0.1:54321 (RTU over TCP)"),
        (
            {"driver": "robotiq_rtu_tcp", "tcp_port": 4001},
            "gripper at 10.0.0.1:4001 (RTU over TCP)",
        ),
        ({"driver": "robotiq_urcap", "host": "10.0.0.2"}, "gripper at 10.0.0.2:63352 (URCap)"),
    ],
)
def test_the_cell_file_chooses_the_wire(section: dict[str, object], name: str) -> None:
    fields = GripperSection.model_validate({"open_counts": 7} | section)
    gripper = robotiq_gripper(fields, arm_host="10.0.0.1", clock=PacedClock(1.0))
    assert gripper.name == name


def test_a_serial_gripper_needs_its_port() -> None:
    with pytest.raises(ValidationError, match="robotiq_rtu needs port"):
        GripperSection(driver="robotiq_rtu")


def test_constructing_opens_nothing() -> None:
    with bench_on("urcap") as bench:
        for wire in WIRES:
            assert RobotiqGripper(wire_to(bench.emulator, wire), clock=bench.clock).max_width
        assert not bench.emulator.connections


def assert_stopped(bench: Bench) -> None:
    width = bench.jaws.state().width
    assert 0.001 < width < 0.085
    bench.clock.sleep(0.2)
    assert bench.jaws.state().width == width
