"""Diagnosis of a folder of logs: one table, no repeated work, local processes and a Dask cluster.

The logs are synthetic.
"""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.identify.diagnosis.nominal import MODEL
from tsa_ctrl.cli import main
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.fleet import Row, logs_in, sweep
from tsa_ctrl.identify.fleet.executors import Workers
from tsa_ctrl.identify.fleet.ledger import LEDGER, TABLE
from tsa_ctrl.identify.fleet.sweep import Done, Job

T = np.arange(0.0, 12.0, 0.005)
X, PRETENSION = 0.28, 42.0


def write_log(path: Path, viscous: float, seed: int) -> None:
    """Write a log of (3.55) with white noise and viscous friction of coefficient `viscous` (N*m*s/rad)."""
    rng = np.random.default_rng(seed)
    omega = 1.2 * np.cos(2.0 * np.pi * 0.4 * T) * (0.6 + 0.4 * np.sin(2.0 * np.pi * 0.05 * T))
    tau_m = 0.4 * np.sin(2.0 * np.pi * 0.17 * T) + 0.2 * np.sin(2.0 * np.pi * 0.31 * T + 1.0)
    tau_j = 0.025 * (tau_m / 0.02 * np.cosh(X) - 2.0 * PRETENSION * np.sign(omega) * np.sinh(X)) - viscous * omega
    table = np.column_stack([T, tau_m, omega, tau_j + 5e-3 * rng.normal(size=T.size)])
    np.savetxt(path, table, delimiter=",", header="t,tau_m,omega_j,tau_j", comments="", fmt="%.9g")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two good logs, a log without joint torque and a file that is not a log."""
    folder = tmp_path_factory.mktemp("logs")
    write_log(folder / "drive_1.csv", 0.0, 1)
    write_log(folder / "drive_2.csv", 0.05, 2)
    (folder / "drive_3.csv").write_text("t,tau_m,omega_j\n" + "".join(f"{0.01 * k},0.1,1\n" for k in range(50)))
    (folder / "notes.txt").write_text("not a log\n")
    return folder


@pytest.fixture(scope="module")
def short(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return logs with the same names that are too short for a diagnosis, so that the test is fast."""
    logs = tmp_path_factory.mktemp("short")
    for name, lines in (("drive_1.csv", 300), ("drive_2.csv", 300), ("drive_3.csv", 50)):
        (logs / name).write_text("\n".join((folder / name).read_text().splitlines()[:lines]) + "\n")
    return logs


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "actuator.toml"
    path.write_text(MODEL)
    return path


class Counting(Executor):
    """An executor with one thread that counts its jobs."""

    def __init__(self) -> None:
        self.jobs = 0
        self._thread = ThreadPoolExecutor(1)

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.jobs += 1
        return self._thread.submit(fn, *args, **kwargs)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the diagnosis by an immediate answer, for tests of the book-keeping."""

    def answer(job: Job) -> Done:
        return Done(Row(job.name, job.key, "consistent"), {"diagnosis.json": b"{}"})

    monkeypatch.setattr(sys.modules["tsa_ctrl.identify.fleet.sweep"], "carry_out", answer)


def swept(folder: Path, model: Path, out: Path, **more: Any) -> tuple[list[Row], int]:
    """Return the rows and the number of logs that were diagnosed for them."""
    executor = Counting()
    return sweep(logs_in(folder), model, out, Workers(executor, 1), **more), executor.jobs


@pytest.fixture(scope="module")
def done(folder: Path, model: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the output folder of a complete run."""
    out = tmp_path_factory.mktemp("fleet") / "out"
    swept(folder, model, out)
    return out


def table(out: Path) -> dict[str, dict[str, str]]:
    with (out / TABLE).open(newline="") as file:
        return {line["log"]: line for line in csv.DictReader(file)}


@pytest.mark.slow
def test_each_log_has_a_row_with_its_verdict_or_the_reason_and_a_report(done: Path) -> None:
    rows = table(done)
    assert list(rows) == ["drive_1.csv", "drive_2.csv", "drive_3.csv"]
    assert rows["drive_1.csv"]["causes"] == ""
    assert "viscous_friction" in rows["drive_2.csv"]["causes"]
    assert float(rows["drive_2.csv"]["rms_extended"]) < float(rows["drive_2.csv"]["rms_recalibrated"])
    assert rows["drive_3.csv"]["verdict"] == "error"
    assert rows["drive_3.csv"]["error"].startswith("drive_3.csv: column tau_j is missing")
    said = json.loads((done / "drive_2.csv" / "diagnosis.json").read_text())
    assert rows["drive_2.csv"]["verdict"] == said["verdict"]
    for name in ("report.html", "extended.toml"):
        assert (done / "drive_2.csv" / name).is_file()


@pytest.mark.usefixtures("quick")
class TestResumption:
    """A folder is diagnosed once, regardless of the number of interruptions."""

    def test_another_model_or_seed_is_another_question(self, folder: Path, model: Path, tmp_path: Path) -> None:
        """An earlier model is diagnosed again, because its reports were replaced."""
        other = tmp_path / "other.toml"
        other.write_text(MODEL.replace("value = 45.0", "value = 40.0"))
        for each, seed in ((model, 0), (other, 0), (model, 0), (model, 1)):
            assert swept(folder, each, tmp_path / "out", seed=seed)[1] == 3

    def test_a_log_that_changed_is_asked_again(self, model: Path, tmp_path: Path) -> None:
        for name in ("a.csv", "b.csv"):
            (tmp_path / name).write_text(f"t {name}\n")
        assert swept(tmp_path, model, tmp_path / "out")[1] == 2
        (tmp_path / "a.csv").write_text("t\n1\n")
        assert swept(tmp_path, model, tmp_path / "out")[1] == 1

    def test_it_goes_on_where_it_stopped(self, folder: Path, model: Path, tmp_path: Path) -> None:
        def interrupt(done: int, total: int, row: Row | None) -> None:
            if done == 1:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            swept(folder, model, tmp_path, progress=interrupt)
        assert len(table(tmp_path)) == 1
        rows, jobs = swept(folder, model, tmp_path)
        assert (len(rows), jobs) == (3, 2)

    @pytest.mark.parametrize("cut", [lambda line: line[:-40], lambda line: line.partition(b"\xcf")[0] + b"\xcf"])
    def test_a_line_that_was_cut_short_is_asked_again(
        self, model: Path, tmp_path: Path, cut: Callable[[bytes], bytes]
    ) -> None:
        """An interruption may end a line anywhere, also within a character."""
        (tmp_path / "a_\N{GREEK SMALL LETTER TAU}.csv").write_text("t\n")
        swept(tmp_path, model, tmp_path / "out")
        path = tmp_path / "out" / LEDGER
        path.write_bytes(cut(path.read_bytes()))
        assert swept(tmp_path, model, tmp_path / "out")[1] == 1
        assert swept(tmp_path, model, tmp_path / "out")[1] == 0

    def test_a_report_that_is_gone_is_made_again(self, folder: Path, model: Path, tmp_path: Path) -> None:
        swept(folder, model, tmp_path)
        (tmp_path / "drive_1.csv" / "diagnosis.json").unlink()
        assert swept(folder, model, tmp_path)[1] == 1


def test_a_failed_diagnosis_leaves_no_earlier_report_under_its_name(short: Path, model: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "drive.csv").write_bytes((short / "drive_1.csv").read_bytes())
    swept(logs, model, out)
    assert (out / "drive.csv" / "extended.toml").is_file()
    (logs / "drive.csv").write_text("t,tau_m\n")
    (row,), _ = swept(logs, model, out)
    assert row.verdict == "error"
    assert all(path.name.endswith(".~1~") for path in (out / "drive.csv").iterdir())


def test_a_folder_without_logs_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="holds no log"):
        logs_in(tmp_path)


@pytest.mark.slow
def test_the_command_uses_processes_and_prints_what_the_table_holds(short: Path, model: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tsa_ctrl", "diagnose", str(short), "--model", str(model)]
    run = subprocess.run(
        [*command, "--out", str(tmp_path), "--jobs", "2", "--json"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    data = json.loads(run.stdout)
    assert data["schema"] == 1
    assert {row["log"]: row["verdict"] for row in data["logs"]} == {
        name: row["verdict"] for name, row in table(tmp_path).items()
    }
    assert data["verdicts"] == {"insufficient": 2, "error": 1}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--hold-out", "x*"], "--hold-out"), (["more.csv"], "is a folder"), (["--scheduler", "nowhere"], "--scheduler")],
)
def test_what_cannot_be_meant_of_a_folder_is_one_line(
    folder: Path,
    model: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["diagnose", str(folder), "--model", str(model), "--out", str(tmp_path), *arguments])
    said = capsys.readouterr()
    assert stop.value.code in (1, 2)
    assert said.out == ""
    assert message in said.err
    assert said.err.count("\n") == 1


def children_of(pid: int) -> list[int]:
    """Return the descendant processes of `pid`, from /proc."""
    below, found = {pid}, []
    parents = {}
    for path in Path("/proc").iterdir():
        if path.name.isdigit():
            try:
                parents[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
    for child in sorted(parents):
        if parents[child] in below:
            below.add(child)
            found.append(child)
    return found


@pytest.mark.slow
def test_ctrl_c_leaves_a_table_and_no_process(model: Path, tmp_path: Path) -> None:
    logs, out = tmp_path / "logs", tmp_path / "out"
    logs.mkdir()
    for number in range(6):
        write_log(logs / f"drive_{number}.csv", 0.05, number)
    # too short for a diagnosis: its result is there soon, while the other logs are diagnosed
    first = logs / "drive_0.csv"
    first.write_text("\n".join(first.read_text().splitlines()[:300]) + "\n")
    command = [sys.executable, "-m", "tsa_ctrl", "diagnose", str(logs), "--model", str(model), "--out", str(out)]
    process = subprocess.Popen([*command, "--jobs", "2"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 300.0
    while not (out / LEDGER).exists() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    workers = children_of(process.pid)
    process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == 1
    assert errors.splitlines()[-1] == "tsa: interrupted"
    assert "Traceback" not in errors
    assert 1 <= len(table(out)) < 6
    assert workers
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.monotonic() < end:
        time.sleep(0.02)
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers)


def test_an_unexpected_failure_costs_one_row(folder: Path, model: Path, tmp_path: Path, monkeypatch: Any) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("nobody thought of this")

    monkeypatch.setattr(sys.modules["tsa_ctrl.identify.fleet.sweep"], "diagnose", broken)
    rows, _ = swept(folder, model, tmp_path)
    assert {row.error for row in rows} >= {"ZeroDivisionError: nobody thought of this"}


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Return the address of a Dask scheduler with a worker in a thread.

    A separate process takes two seconds to start.
    """
    distributed = pytest.importorskip("distributed", reason="no Dask: pip install '.[fleet]'")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
    ) as made:
        yield made.scheduler_address


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_table(cluster: str, short: Path, model: Path, tmp_path: Path) -> None:
    here = tmp_path / "here"
    swept(short, model, here)
    command = [sys.executable, "-m", "tsa_ctrl", "diagnose", str(short), "--model", str(model)]
    run = subprocess.run(
        [*command, "--out", str(tmp_path), "--scheduler", cluster],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert (tmp_path / TABLE).read_text() == (here / TABLE).read_text()
    assert (tmp_path / "drive_2.csv" / "report.html").is_file()
