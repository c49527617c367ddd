"""A whole cell on the true wires: what is seen and grasped, and faults in mid-episode."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from emulated_cell import EmulatorRig, TallestGrasp, cubes, emulator, small_cell
from terminal import Terminal
from ur_rig import processes_of

from policies.shipped import NamedPolicy
from tdpg_deploy.cell import open_cell
from tdpg_deploy.cli import session
from tdpg_deploy.cli.emulate import main as emulate
from tdpg_deploy.cli.run import main
from tdpg_deploy.drivers.ur5_network import RTDE_PORT
from tdpg_deploy.emulators.cell_file import format_cell
from tdpg_deploy.emulators.cell_pendant import CellPendant
from tdpg_deploy.episode_log.reader import read_episode
from tdpg_deploy.episode_record import EpisodeResult
from tdpg_deploy.outcome import EndReason
from tdpg_deploy.perception import build_heightmap
from tdpg_deploy.sim.scenes import random_scene
from tdpg_deploy.workspace import workspace_of

DOCS = Path(__file__).parents[3] / "docs"
PLACES = ((0.50, 0.10), (0.43, -0.08), (0.60, -0.06), (0.58, 0.16))
PIXEL = 0.002  # m


@pytest.fixture(autouse=True)
def tallest_grasp(monkeypatch: pytest.MonkeyPatch) -> None:
    """What tdpg-run decides by, in this process."""
    policy = NamedPolicy(name="tallest", decider=TallestGrasp(), sha256=None)
    monkeypatch.setattr(session, "open_policy", lambda _, *, goal: policy)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatorRig]:
    """One cell with four cubes, for all faults: none of them takes more than one away."""
    directory = tmp_path_factory.mktemp("cell")
    scene = cubes(directory, *PLACES)
    with emulator(small_cell(), "--scene", scene, "--pace", "2") as rig:
        yield rig


def run_real(rig: EmulatorRig, out: Path) -> int:
    options = ("--real", "--unattended", "--speed", "1", "--config", rig.file, "--out", out)
    return main([str(option) for option in options])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("driver", "model"),
    [
        (driver, model)
        for driver in ("robotiq_rtu", "robotiq_rtu_tcp", "robotiq_urcap")
        for model in ("ur5", "ur5e")
    ],
)
def test_it_is_seen_and_grasped_alike(driver: str, model: str, tmp_path: Path) -> None:
    """The same first action as in the mock cell, with each arm and on each wire of the gripper."""
    wire = {"driver": driver, "port": "/dev/serial/by-id/none"}
    options = ("--objects", "2", "--seed", "3", "--model", model)
    first = []
    with emulator(small_cell(**wire), *options) as rig:
        config = rig.config
        scene = random_scene(2, workspace_of(config), np.random.default_rng(3))
        with open_cell(config, real=True) as real, open_cell(config, scene=scene, seed=3) as mock:
            for cell in (real, mock):
                seen = build_heightmap(
                    cell.camera.capture(), config.X_base_camera, workspace_of(config)
                )
                first.append(TallestGrasp().decide(seen, np.random.default_rng(3)).primitive)
            assert np.allclose(real.arm.state().q, mock.arm.state().q, atol=1e-3)
            real.gripper.activate()
            state = real.gripper.move(0.04, speed=0.1, force=20.0)
            assert state.width == pytest.approx(0.04, abs=0.001)
    ours, theirs = first
    assert type(ours) is type(theirs)
    assert (ours.x, ours.y) == pytest.approx((theirs.x, theirs.y), abs=1.01 * PIXEL)
    assert ours.z == pytest.approx(theirs.z, abs=0.002)
    assert ours.yaw == theirs.yaw


def result_in(folder: Path) -> EpisodeResult:
    """Of the one log there; it is closed."""
    (log,) = folder.glob("*.mcap")
    result = read_episode(log).result()
    assert result is not None
    return result


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "mended", "said"),
    [
        ("protective_stop", "reset", "ProtectiveStop"),
        ("emergency_stop", "reset", "EmergencyStop"),
        ("freeze", "reset", "DeviceUnreachable"),
        ("lose_power", "reset", "DeviceUnreachable"),
        ("gripper_mute", "gripper_speak", "DeviceTimeout"),
        ("gripper_lose_power", "gripper_restore_power", "GripperError"),
        ("camera_stall", "camera_resume", "DeviceTimeout"),
        ("camera_freeze", "camera_resume", "CameraError"),
        ("camera_tear seconds=0.3", "camera_resume", "CameraError"),
        ("camera_unplug", "camera_plug_in", "DeviceTimeout"),
    ],
)
def test_a_fault_stops_the_arm_and_closes_the_log(
    cell: EmulatorRig, fault: str, mended: str, said: str, tmp_path: Path
) -> None:
    def strike() -> None:
        cell.wait_for_motion()
        cell.do(fault)

    striking = threading.Thread(target=strike)
    striking.start()
    code = run_real(cell, tmp_path)
    striking.join()
    assert code == 3
    cell.wait_for_rest()
    assert cell.stands_still()
    assert cell.do("truth")["runtime"] != "PLAYING"
    assert processes_of(cell.host) == {}
    cell.do(mended)
    result = result_in(tmp_path)
    assert result.reason is EndReason.DEVICE_ERROR
    assert result.error is not None
    assert result.error.startswith(said)


@pytest.mark.slow
def test_holes_in_the_depth_are_unknown(cell: EmulatorRig) -> None:
    cell.do("camera_holes share=0.25")
    with open_cell(cell.config, real=True) as real:
        depth = real.camera.capture().depth
    cell.do("camera_resume")
    assert np.isnan(depth[:, :155]).all()
    assert np.isfinite(depth[:, 165:]).mean() > 0.9


@pytest.mark.slow
def test_ctrl_c_stops_the_arm_and_closes_the_log(cell: EmulatorRig, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "tdpg_deploy.cli.run", "--real", "--unattended"),
            *("--policy", "random", "--config", cell.file, "--out", tmp_path),
        ]
    )
    cell.wait_for_motion()
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=30) == 130
    cell.wait_for_rest()
    assert cell.stands_still()
    result = result_in(tmp_path)
    assert result.reason is EndReason.OPERATOR_STOP


@pytest.mark.slow
def test_a_whole_cell_that_dies_leaves_a_closed_log(tmp_path: Path) -> None:
    """As when the mains fail."""
    rig = EmulatorRig(small_cell(), "--objects", "2", "--pace", "2")
    with rig:

        def strike() -> None:
            rig.wait_for_motion()
            rig.kill()

        striking = threading.Thread(target=strike)
        striking.start()
        assert run_real(rig, tmp_path) == 3
        striking.join()
        assert processes_of(rig.host) == {}
    result = result_in(tmp_path)
    assert result.reason is EndReason.DEVICE_ERROR
    assert result.error is not None
    assert result.error.startswith("DeviceUnreachable")


@pytest.mark.slow
@pytest.mark.real_time
def test_a_person_is_asked_and_ctrl_c_stops_the_arm(cell: EmulatorRig, tmp_path: Path) -> None:
    cell.do("reset")
    before = cell.do("truth")["q"]
    with tdpg_run_in_a_terminal(cell, tmp_path) as terminal:
        terminal.wait_for("is going to move")
        terminal.wait_for("0.12 m/s in free space")  # a quarter of the cell's 0.5 m/s
        terminal.wait_for("Type yes to go on: ")
        terminal.type("no\n")
        assert terminal.exit_code() == 2
    assert list(tmp_path.iterdir()) == []
    assert np.allclose(cell.do("truth")["q"], before, atol=1e-4)
    with tdpg_run_in_a_terminal(cell, tmp_path, "--step") as terminal:
        terminal.wait_for("Type yes to go on: ")
        terminal.type("yes\n")
        terminal.wait_for("stops above 15 N")  # the plan is shown
        terminal.wait_for("Go? (y/N) ")
        cell.wait_for_rest()
        assert np.allclose(cell.do("truth")["q"], cell.config.arm.home, atol=1e-3)
        terminal.type("y\n")
        cell.wait_for_motion()
        fastest = max(cell.do("truth")["speed"] for _ in range(100))
        assert fastest < 0.25 * cell.config.limits.joint_speed * 1.05
        terminal.type("\x03")
        assert terminal.exit_code() == 130
    cell.wait_for_rest()
    assert cell.stands_still()
    result = result_in(tmp_path)
    assert result.reason is EndReason.OPERATOR_STOP


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.parametrize(("answer", "safety"), [("yes", "NORMAL"), ("no", "PROTECTIVE_STOP")])
def test_a_protective_stop_is_released_when_a_person_says_so(
    cell: EmulatorRig, answer: str, safety: str, tmp_path: Path
) -> None:
    cell.do("reset")
    with tdpg_run_in_a_terminal(cell, tmp_path) as terminal:
        terminal.wait_for("Type yes to go on: ")
        terminal.type("yes\n")
        terminal.wait_for("Go? (y/N) ")
        terminal.type("y\n")
        cell.wait_for_motion()
        cell.do("protective_stop")
        terminal.wait_for("ProtectiveStop: protective stop: look at the arm")
        terminal.wait_for("Type yes to release it (nothing will move): ")
        stopped_at = cell.do("truth")["q"]
        terminal.type(f"{answer}\n")
        assert terminal.exit_code() == 3
    truth = cell.do("truth")
    assert truth["safety"] == safety
    assert np.allclose(truth["q"], stopped_at, atol=1e-3)
    assert truth["runtime"] != "PLAYING"


@contextmanager
def tdpg_run_in_a_terminal(cell: EmulatorRig, out: Path, *options: str) -> Iterator[Terminal]:
    run = ("tdpg_deploy.cli.run", "--real", "--policy", "random", "--config", cell.file)
    with Terminal([sys.executable, "-m", *map(str, run), "--out", str(out), *options]) as terminal:
        yield terminal


@pytest.mark.parametrize("pace", ["0", "4.5"])
def test_a_pace_at_which_contacts_are_felt_too_late_is_refused(
    pace: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        emulate(["--pace", pace])
    assert ended.value.code == 2
    assert "not within 0 to 4: the faster the cell, the later" in capsys.readouterr().err


def test_a_taken_address_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = small_cell()
    file = tmp_path / "cell.toml"
    file.write_text(format_cell(config))
    with socket.create_server((config.arm.host, RTDE_PORT)):
        assert emulate([str(file), "--objects", "1"]) == 2
    said = capsys.readouterr().err
    assert config.arm.host in said
    assert "another loopback address" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("dance", "no such command: dance"),
        ("obey", "no such command: obey"),
        ("speed_slider", "it takes share"),
        ("speed_slider share=half", "speed_slider: Expecting value"),
        ("objects where=1", "it takes nothing"),
    ],
)
def test_a_mistyped_command_is_named(cell: EmulatorRig, typed: str, expected: str) -> None:
    assert expected in cell.type(typed)["error"]


def test_every_command_is_documented() -> None:
    page = (DOCS / "emulate.md").read_text(encoding="utf-8")
    assert [name for name in CellPendant.commands() if f"`{name}" not in page] == []
