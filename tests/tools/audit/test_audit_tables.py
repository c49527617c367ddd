"""Rows, Parquet, SQL, and the command."""

from __future__ import annotations

import signal
import subprocess
import sys
import tracemalloc
from dataclasses import fields, replace
from pathlib import Path

import duckdb
import pyarrow.parquet as pq
import pytest
from audited_logs import make_logs
from synthetic_episode import ABOUT, Synthetic, write_about

from tdpg_deploy.errors import ConfigError, LogError
from tools.audit.cli import main
from tools.audit.engines import Engine, in_parallel
from tools.audit.parquet import ACTIONS, EPISODES
from tools.audit.rows import ActionRecord, EpisodeRecord, audit_log
from tools.audit.run import find_logs
from tools.audit.tally import Tally
from tools.evaluate.metrics import evaluate
from tools.evaluate.rows import read_row


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    make_logs(folder)
    return folder


@pytest.fixture(scope="module")
def tables(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tables")
    assert main([str(logs), "--out", str(out), "--workers", "1"]) == 3  # one is not a log
    return out


def test_the_tables_have_the_records_columns(tables: Path) -> None:
    for file, kind in ((EPISODES, EpisodeRecord), (ACTIONS, ActionRecord)):
        assert pq.read_schema(tables / file).names == [field.name for field in fields(kind)]


def test_the_tables_say_what_the_logs_say(logs: Path, tables: Path) -> None:
    with duckdb.connect() as connection:
        rows = connection.execute(
            f"SELECT episode, actions, grasps, grasp_successes, seed FROM '{tables / EPISODES}' "
            "WHERE reason IS NOT NULL ORDER BY episode"
        ).fetchall()
        numbers = connection.execute(
            f"SELECT episode, count(*), count(cause) FROM '{tables / ACTIONS}' "
            "GROUP BY 1 ORDER BY 1"
        ).fetchall()
    assert [row[0] for row in rows] == ["night 0/episode0", "night 0/episode1", "night 1/episode2"]
    for name, actions, grasps, successes, seed in rows:
        row = read_row(logs / f"{name}.mcap", scene="")
        assert (row.actions, row.grasps, row.grasp_successes, row.seed) == (
            actions, grasps, successes, seed,
        )  # fmt: skip
    assert numbers[0][0] == "cut"
    assert numbers[1:] == [(row[0], 3, 2) for row in rows]  # yes, no, unknown


def test_a_goal_is_the_one_object_that_counts(tmp_path: Path) -> None:
    synthetic = Synthetic()
    path = tmp_path / "log.mcap"
    write_about(
        path, synthetic.episode(2, goal=True), replace(ABOUT, scene=None), now=synthetic.now
    )
    row, expected = audit_log(path, name="log").row, read_row(path, scene="")
    assert row is not None
    assert (row.goal, row.objects) == (expected.goal, expected.objects) == (True, 1)


def test_a_log_that_lost_an_outcome_is_not_judged(tmp_path: Path) -> None:
    synthetic = Synthetic()
    calls = synthetic.episode(2)
    calls.remove(next(call for call in calls if call.name == "conclude"))
    write_about(tmp_path / "log.mcap", calls, replace(ABOUT, scene=None), now=synthetic.now)
    with pytest.raises(LogError, match="1 outcomes of 2 actions"):
        read_row(tmp_path / "log.mcap", scene="")


def test_many_logs_take_little_memory(logs: Path) -> None:
    log = audit_log(logs / "night 0" / "episode0.mcap", name="episode")
    assert log.row is not None
    tally = Tally()
    tracemalloc.start()
    for number in range(4_000):
        tally.add(replace(log, row=replace(log.row, grasps=5 + number % 7)))
    evaluate(tally.rows)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 80e6  # the 2,000 x 4,000 resamples at once would be 64 MB a time, several times


def test_two_processes_give_the_same_tables(logs: Path, tables: Path, tmp_path: Path) -> None:
    main([str(logs), "--out", str(tmp_path), "--workers", "2"])
    assert rows_of(tmp_path) == rows_of(tables)


def rows_of(tables: Path) -> list[str]:
    """As text, in which nan is nan."""
    return [repr(pq.read_table(tables / file).to_pylist()) for file in (EPISODES, ACTIONS)]


@pytest.mark.slow
def test_ray_gives_the_same_tables(logs: Path, tables: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="ray is not installed: pip install 'tdpg-deploy[ray]'")
    main([str(logs), "--out", str(tmp_path), "--workers", "2", "--engine", "ray"])
    assert rows_of(tmp_path) == rows_of(tables)


def test_a_process_that_is_killed_is_told() -> None:
    tasks = [signal.SIGKILL, signal.SIGKILL]
    with pytest.raises(ConfigError, match="fewer --workers"):
        list(in_parallel(signal.raise_signal, tasks, workers=2, engine=Engine.PROCESSES))


def test_an_engine_that_is_not_installed(
    logs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main([str(logs), "--engine", "ray"]) == 2
    assert "pip install 'tdpg-deploy[ray]'" in capsys.readouterr().out


@pytest.mark.parametrize("package", ["pyarrow", "duckdb"])
def test_a_package_that_is_not_installed(
    logs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], package: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    for module in ("tools.audit.parquet", "tools.audit.sql"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    assert main([str(logs), "--workers", "1", "--sql", "SELECT 1"]) == 2
    assert f"{package} is missing: pip install 'tdpg-deploy[audit]'" in capsys.readouterr().out


def test_sql(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    query = "SELECT a.kind, count(*) AS n FROM actions a JOIN episodes USING (episode) GROUP BY 1"
    assert main([str(logs), "--workers", "1", "--sql", query]) == 3
    assert "grasp" in capsys.readouterr().out


def test_what_a_log_says_stays_as_it_is(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    query = "SELECT '[b]:x:[/b]' AS said, -(0::DOUBLE) AS nought"
    assert main([str(logs), "--workers", "1", "--sql", query]) == 3
    said = capsys.readouterr().out
    assert "[b]:x:[/b]" in said
    assert "-0" not in said


def test_the_summary_says_what_to_change(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main([str(logs), "--workers", "1"])
    said = capsys.readouterr().out
    assert said.startswith(str(logs))
    assert "what to change" in said


def test_bad_sql_is_told(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(logs), "--workers", "1", "--sql", "SELECT nonsense FROM actions"]) == 2
    assert "nonsense" in capsys.readouterr().out


def test_the_summary_names_causes_and_what_was_not_read(
    logs: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    main([str(logs), "--workers", "1"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "4 episodes (1 truncated)" in shown
    assert "stale or torn frame" in shown  # a synthetic clock ticks faster than the arm moves
    assert "none.mcap: not an MCAP file" in shown


def test_comparison_with_itself_finds_no_difference(
    logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(logs), "--workers", "1", "--compare", str(logs)])
    shown = capsys.readouterr().out
    assert "grasp success" in shown
    assert "clear" not in shown


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["nowhere"], "no such folder"), (["{empty}"], "no logs"), (["{logs}", "--serve"], "--html")],
)
def test_bad_input(
    logs: Path, tmp_path: Path, arguments: list[str], message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    places = {"empty": str(tmp_path), "logs": str(logs)}
    assert main([argument.format(**places) for argument in arguments]) == 2
    assert message in capsys.readouterr().out


def test_logs_are_found_below_the_folder(logs: Path) -> None:
    found = [path.relative_to(logs).as_posix() for path in find_logs(logs)]
    assert found == [
        "cut.mcap.part", "night 0/episode0.mcap", "night 0/episode1.mcap",
        "night 1/episode2.mcap", "none.mcap",
    ]  # fmt: skip


def test_help_is_light() -> None:
    heavy = ["torch", "cv2", "scipy", "numpy", "pyarrow", "duckdb", "mcap"]
    code = (
        "import sys, tools.audit.cli as cli; cli.parser(); "
        f"print([m for m in {heavy} if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_workers_load_what_they_need_and_no_more() -> None:
    heavy = ["torch", "pybullet", "numba", "scipy.stats", "pyarrow", "duckdb", "rich"]
    code = (
        "import sys, tools.audit.run, tools.audit.site_build; "
        f"print([m for m in {heavy} if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
