"""tdpg-doctor over emulated devices: what it finds, and that nothing moves."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated_d435 import INTRINSICS, SERIAL, Scene
from rich.console import Console
from robotiq_on_wires import Bench, bench_on
from ur_rig import arm_section, emulated_controller, new_host, wait_until

from tdpg_deploy.cell import MachineClock
from tdpg_deploy.cell_config import DEFAULT_CELL, ArmSection, CellConfig, GripperSection, load_cell
from tdpg_deploy.cli.doctor import main
from tdpg_deploy.doctor import arm as arm_examination
from tdpg_deploy.doctor import camera as camera_examination
from tdpg_deploy.doctor.arm import examine_arm
from tdpg_deploy.doctor.camera import examine_camera, judge_noise, judge_table
from tdpg_deploy.doctor.examination import examine
from tdpg_deploy.doctor.finding import Finding, Verdict, as_document, as_line, judge, summary
from tdpg_deploy.doctor.gripper import examine_gripper
from tdpg_deploy.doctor.moves import move_arm, move_gripper
from tdpg_deploy.doctor.rtde_watch import Listening, listen
from tdpg_deploy.drivers.realsense import RealsenseCamera
from tdpg_deploy.drivers.ur5 import UrArm
from tdpg_deploy.emulators.realsense import EmulatedD435, holes
from tdpg_deploy.emulators.robotiq import FaultCode
from tdpg_deploy.emulators.ur_controller.process import ControllerProcess
from tdpg_deploy.errors import DeviceUnreachable
from tdpg_deploy.kinematics import MODELS, UR5

GOOD, DOUBT, BAD = Verdict.GOOD, Verdict.DOUBT, Verdict.BAD
PACED = {"states", "rate", "answers"}  # hang on this machine's load: judged by numbers below


def verdicts(findings: Iterable[Finding]) -> dict[str, Verdict]:
    return {f.check: f.verdict for f in findings if f.check not in PACED}


# --- arm --------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=MODELS)
def controller(request: pytest.FixtureRequest) -> Iterator[tuple[ArmSection, ControllerProcess]]:
    section = arm_section(new_host(), request.param)
    with emulated_controller(section.host, model=section.model) as robot:
        yield section, robot


@pytest.fixture
def robot(controller: tuple[ArmSection, ControllerProcess]) -> ControllerProcess:
    controller[1].do("reset")
    return controller[1]


@pytest.fixture
def config(controller: tuple[ArmSection, ControllerProcess]) -> CellConfig:
    return load_cell(DEFAULT_CELL).model_copy(update={"arm": controller[0]})


def test_a_sound_arm(config: CellConfig, robot: ControllerProcess) -> None:
    before = robot.do("truth")
    findings = list(examine_arm(config.arm))
    assert set(verdicts(findings).values()) == {GOOD}
    after = robot.do("truth")
    assert after["q"] == before["q"]
    assert after["runtime"] == before["runtime"]  # no program was started
    joints = next(f.measured for f in findings if f.check == "joints")
    assert f"{np.degrees(before['q'][1]):.1f}" in joints


def test_an_arm_that_may_not_move(config: CellConfig, robot: ControllerProcess) -> None:
    robot.do("protective_stop")
    robot.do("speed_slider", share=0.0)
    findings = list(examine_arm(config.arm))
    assert verdicts(findings)["mode"] is BAD
    assert verdicts(findings)["speed slider"] is BAD
    mode = next(f for f in findings if f.check == "mode")
    assert mode.measured == "RUNNING, safety PROTECTIVE_STOP"
    assert "look at the arm" in mode.remedy


def test_a_cell_file_for_the_other_arm(config: CellConfig) -> None:
    (other,) = MODELS.keys() - {config.arm.model}
    findings = list(examine_arm(config.arm.model_copy(update={"model": other})))
    assert verdicts(findings)["model"] is BAD
    model = next(f for f in findings if f.check == "model")
    assert model.measured == config.arm.dh.name
    assert f'set arm.model = "{config.arm.model}"' in model.remedy


def test_arms_that_are_not_told_or_not_known() -> None:
    assert arm_examination.judge_model(None, UR5).verdict is DOUBT
    ur10 = arm_examination.judge_model("UR10", UR5)
    assert (ur10.verdict, ur10.remedy) == (BAD, "use one of UR5, UR5e")


def test_the_states_are_heard_as_the_controller_sends_them(
    config: CellConfig, robot: ControllerProcess
) -> None:
    robot.do("speed_slider", share=0.5)
    heard = listen(config.arm.host, rate=125.0)
    assert heard.rate == pytest.approx(125.0, rel=0.02)  # by the controller's own clock
    assert heard.slider == 0.5
    assert heard.q == pytest.approx(robot.do("truth")["q"])


def test_local_control_is_told_on_an_e_series(config: CellConfig, robot: ControllerProcess) -> None:
    robot.do("local_control")
    found = verdicts(examine_arm(config.arm))
    robot.do("remote_control")
    assert found.get("remote control") in (BAD, None)  # CB3 has none


@pytest.mark.parametrize(
    ("rate", "gap", "verdict"), [(125, 0.009, GOOD), (60, 0.03, DOUBT), (125, 0.2, DOUBT)]
)
def test_states_are_judged_by_rate_and_gaps(rate: float, gap: float, verdict: Verdict) -> None:
    heard = Listening(rate=rate, longest_gap=gap, q=(0.0,) * 6, slider=1.0)
    assert arm_examination.judge_rate(heard, 125.0).verdict is verdict


# --- gripper ----------------------------------------------------------------------------------


@pytest.fixture
def bench() -> Iterator[Bench]:
    with bench_on("rtu_over_tcp") as bench:
        yield bench


def test_a_sound_gripper(bench: Bench) -> None:
    assert verdicts(examine_gripper(bench.gripper, GripperSection())) == {
        "fault": GOOD, "activation": DOUBT, "position": GOOD,
    }  # fmt: skip
    assert bench.jaws.state().width == 0.085
    wait_until(lambda: not bench.emulator.connections)
    bench.gripper.connect()
    bench.gripper.activate()
    bench.gripper.close()
    assert set(verdicts(examine_gripper(bench.gripper, GripperSection())).values()) == {GOOD}


def test_a_gripper_with_a_fault_and_other_counts(bench: Bench) -> None:
    bench.gripper.connect()
    bench.gripper.activate()
    bench.gripper.close()
    findings = list(examine_gripper(bench.gripper, GripperSection(open_counts=10)))
    assert verdicts(findings)["position"] is DOUBT
    assert "set them to what it reports" in findings[-1].remedy
    bench.model.fail(FaultCode.UNDERVOLTAGE)
    findings = list(examine_gripper(bench.gripper, GripperSection()))
    fault = next(f for f in findings if f.check == "fault")
    assert (fault.verdict, fault.measured) == (BAD, "gFLT 0x0A UNDERVOLTAGE")
    assert "24 V" in fault.remedy


# --- camera -----------------------------------------------------------------------------------

PINHOLE = replace(INTRINSICS, distortion=(0.0,) * 5)


class Table(Scene):
    """The mock cell's empty table as an ideal camera sees it, `lift` metres too high."""

    def __init__(self, cell: CellConfig, *, lift: float = 0.0, noise: float = 0.0005) -> None:
        super().__init__(PINHOLE)
        self._rng = np.random.default_rng(5)
        self._noise = noise
        v, u = np.mgrid[:480, :640]
        rays = np.stack([(u - PINHOLE.cx) / PINHOLE.fx, (v - PINHOLE.cy) / PINHOLE.fy, 0 * u + 1])
        X = cell.X_base_camera.as_matrix()
        fall = np.tensordot(X[2, :3], rays, 1)
        self.ideal = (cell.workspace.table_z + lift - X[2, 3]) / fall

    def frame(self) -> Any:
        self.depth = (self.ideal + self._rng.normal(0, self._noise, (480, 640))).astype(np.float32)
        return super().frame()


def examined(scene: Scene, cell: CellConfig, *, hole: float = 0.0) -> list[Finding]:
    source = EmulatedD435(scene.frame, serial=SERIAL)
    source.fault = holes(hole)
    camera = RealsenseCamera(cell.camera, clock=MachineClock(), source=source, warm_up=0.0)
    return list(examine_camera(camera, cell))


@pytest.fixture
def cell() -> CellConfig:
    cell = load_cell(DEFAULT_CELL)
    return cell.model_copy(update={"camera": cell.camera.model_copy(update={"width": 640})})


def test_a_sound_camera(cell: CellConfig) -> None:
    findings = examined(Table(cell), cell)
    found = verdicts(findings)
    assert found.pop("calibration") is DOUBT  # its pose is typed in
    assert set(found.values()) == {GOOD}
    assert SERIAL in findings[0].measured


def test_a_camera_out_of_place_and_half_blind(cell: CellConfig) -> None:
    findings = examined(Table(cell, lift=0.020), cell, hole=0.5)
    found = verdicts(findings)
    assert found["workspace seen"] is BAD
    assert found["table"] is BAD
    table = next(f for f in findings if f.check == "table")
    assert float(table.measured.split()[0]) == pytest.approx(20.0, abs=2.0)
    assert "calibrate" in table.remedy


@pytest.mark.parametrize(("sigma", "verdict"), [(0.001, GOOD), (0.02, DOUBT)])
def test_noise_is_judged_by_what_a_d435_does(sigma: float, verdict: Verdict) -> None:
    rng = np.random.default_rng(0)
    depths = rng.normal(0.7, sigma, (15, 40, 40)).astype(np.float32)
    finding = judge_noise(depths, 615.0)
    assert finding.verdict is verdict
    assert float(finding.measured.split()[0]) == pytest.approx(sigma * 1e3, rel=0.1)


def test_nothing_seen_at_all() -> None:
    assert judge_noise(np.full((3, 4, 4), np.nan, np.float32), 600.0).verdict is DOUBT
    (seen,) = judge_table(np.full((224, 224), np.nan, np.float32))
    assert seen.verdict is BAD


def test_the_rate_is_judged_by_the_cell_file() -> None:
    assert camera_examination.judge_rate(29.0, 30).verdict is GOOD
    assert camera_examination.judge_rate(5.0, 30).verdict is DOUBT


# --- the whole --------------------------------------------------------------------------------


def test_one_dead_device_does_not_hide_the_next() -> None:
    def dead() -> Iterator[Finding]:
        yield judge("arm", "first", "1", good=True, remedy="")
        raise DeviceUnreachable("the arm is gone: switch it on")

    def sound() -> Iterator[Finding]:
        yield judge("camera", "device", "a D435", good=True, remedy="")

    findings = list(examine({"arm": dead, "camera": sound}))
    assert [f.verdict for f in findings] == [GOOD, BAD, GOOD]
    assert findings[1].measured == "the arm is gone: switch it on"
    assert summary(findings) == "1 bad and 0 doubtful of 3 checks"
    assert summary(findings[2:]) == "all 1 checks are good"
    assert as_document("mine", findings)["healthy"] is False


def test_a_line_fits_its_terminal_and_names_a_device_once() -> None:
    finding = judge("arm", "mode", "IDLE " * 20, good=False, remedy="power it on " * 5)
    with (console := Console(width=80, file=io.StringIO())).capture() as told:
        console.print(as_line(finding, names_device=True))
        console.print(as_line(finding, names_device=False))
    lines = told.get().splitlines()
    assert lines[0].startswith("arm       doubt   mode             IDLE IDLE")
    assert max(map(len, lines)) <= 80
    assert sum(line.startswith("arm") for line in lines) == 1
    assert [line.lstrip()[:14] for line in lines if "->" in line] == ["-> power it on"] * 2


@pytest.fixture
def mock_file(tmp_path: Path) -> Path:
    """A cell file whose devices are all out of reach, at once."""
    path = tmp_path / "cell.toml"
    text = DEFAULT_CELL.read_text(encoding="utf-8")
    text = text.replace("[gripper]", '[gripper]\nhost = "127.0.0.1"\ntcp_port = 1', 1)
    path.write_text(text, encoding="utf-8")
    return path


def test_the_command_tells_and_returns_one(
    mock_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--config", str(mock_file), "--device", "gripper", "--device", "camera"]) == 1
    told = capsys.readouterr().out
    assert "gripper   bad     responds         gripper at 127.0.0.1:1" in told
    assert "camera    bad     responds         camera: not found on USB" in told
    assert told.endswith("2 bad and 0 doubtful of 2 checks\n")


def test_the_command_in_json(mock_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--config", str(mock_file), "--device", "gripper", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    (finding,) = document.pop("findings")
    assert document == {"format": "tdpg-doctor", "version": 1, "cell": "mock", "healthy": False}
    assert finding.keys() == {"device", "check", "verdict", "measured", "remedy"}
    assert (finding["device"], finding["verdict"]) == ("gripper", "bad")
    page = (Path(__file__).parents[3] / "docs" / "doctor.md").read_text(encoding="utf-8")
    assert [key for key in (*document, *finding) if f"| `{key}` |" not in page] == []


def test_a_wrong_cell_file_is_no_diagnosis(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--config", str(tmp_path / "none.toml")]) == 2
    assert "cannot be read" in capsys.readouterr().err


@pytest.mark.slow
def test_small_motions_of_the_arm(config: CellConfig, robot: ControllerProcess) -> None:
    before = robot.do("truth")["q"]
    (finding,) = move_arm(UrArm(config.arm, clock=MachineClock()), config)
    assert finding.verdict is GOOD
    assert robot.do("truth")["q"] == pytest.approx(before, abs=1e-3)


def test_the_fingers_own_ends_are_told(bench: Bench) -> None:
    section = GripperSection(open_counts=9)
    closed, opened = move_gripper(bench.gripper, section)
    assert (closed.verdict, closed.measured) == (GOOD, "228")
    assert opened.verdict is DOUBT
    assert opened.remedy == "set gripper.open_counts = 3 (now 9)"


@pytest.mark.parametrize(("answer", "moved"), [("yes\n", True), ("no\n", False), ("", False)])
def test_the_command_moves_only_when_told_to(
    answer: str, moved: bool, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    host, port = bench.emulator.serve_urcap("127.0.0.1")
    text = DEFAULT_CELL.read_text(encoding="utf-8")
    text = text.replace("[gripper]", f'[gripper]\nhost = "{host}"\ntcp_port = {port}', 1)
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    monkeypatch.setattr(sys, "stdin", io.StringIO(answer))
    assert main(["--config", str(path), "--device", "gripper", "--move"]) == 0
    assert bool(bench.model.read(2000, 1)[0]) is moved


def test_help_is_light() -> None:
    code = (
        "import sys, tdpg_deploy.cli.doctor as d\n"
        "try: d.main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'torch', 'cv2', 'pyrealsense2', 'pymodbus'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL, timeout=60)
