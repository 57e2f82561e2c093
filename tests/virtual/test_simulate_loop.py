"""Test the real loop on the real plant in virtual time."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.virtual.files import controller, plant, write
from tests.virtual.joints import play, sine
from tests.virtual.test_sensor_truth import BLIND
from tsa_ctrl import simulate_loop
from tsa_ctrl.cli import main
from tsa_ctrl.daemon.summary import ELONGATION, SENSOR
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.log.table import read_table
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.virtual.script import Change, Fault


def test_the_whole_run_from_bring_up_to_shut_down(tmp_path: Path) -> None:
    result = simulate_loop(*write(tmp_path), 1.0)
    assert result.summary.cause == "1 s are over"
    assert not result.summary.failed
    assert result.summary.late == result.summary.skipped == result.summary.missed_pdo == 0
    assert result.log["tau_m_cmd"][-1] == 0.0
    assert np.diff(result.log["t"]) == pytest.approx(1e-3)
    assert set(result.truth["enabled"]) == {0.0, 1.0}


def test_the_same_run_gives_the_same_bytes_and_another_seed_gives_other_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the files of a log, no thread starts, and in no case does any part of the program sleep."""

    def never(*arguments: object) -> None:
        raise AssertionError("in virtual time nobody waits")

    files = write(tmp_path)
    monkeypatch.setattr(time, "sleep", never)
    results = [simulate_loop(*files, 0.5, out=tmp_path / name, record=tmp_path / f"{name}.csv") for name in "ab"]
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert (tmp_path / "a" / "tsa.mcap").read_bytes() == (tmp_path / "b" / "tsa.mcap").read_bytes()
    table = read_table(tmp_path / "a" / "tsa.mcap").columns
    for name in ("t", "tau_j_des", "tau_m_cmd", "tau_j", "q_j", "sigma"):
        assert np.array_equal(table[name], results[0].log[name], equal_nan=True), name
    monkeypatch.setattr(threading.Thread, "start", never)
    assert not np.array_equal(*(simulate_loop(*files, 0.3, seed=seed).log["tau_j"] for seed in (1, 2)))


def test_files_of_before_are_kept(tmp_path: Path) -> None:
    """An earlier log is kept, input files are not overwritten, and a failed run leaves no file."""
    files = write(tmp_path)
    simulate_loop(*files, 0.3, out=tmp_path, seed=1)
    before = (tmp_path / "tsa.mcap").read_bytes()
    simulate_loop(*files, 0.3, out=tmp_path, seed=2)
    assert (tmp_path / "tsa.mcap.~1~").read_bytes() == before
    read = files[1].read_bytes()
    with pytest.raises(UsageError, match=r"--record .*plant.toml: is .*which is read"):
        simulate_loop(*files, 0.3, record=files[1])
    assert files[1].read_bytes() == read
    write(tmp_path, plant_tables=plant(drive={"node_id": 5}))
    present = set(tmp_path.rglob("*"))
    with pytest.raises(BusError, match="no answer from axis 'knee' drive node 1"):
        simulate_loop(*files, 0.5, out=tmp_path, record=tmp_path / "truth.csv")
    assert set(tmp_path.rglob("*")) == present


def test_a_run_closes_and_deletes_what_it_opened(tmp_path: Path) -> None:
    """Neither a run nor one that cannot be built, here by a formula without an inverse, leaves an open file."""
    files = write(tmp_path)
    simulate_loop(*files, 0.1, out=tmp_path / "a", record=tmp_path / "a.csv")
    before = open_files()
    for _ in range(2):
        simulate_loop(*files, 0.1, out=tmp_path / "b", record=tmp_path / "b.csv")
    with (tmp_path / "actuator.toml").open("a") as model:
        model.write('[effects.custom]\nexpression = "2*tau"\n')
    for out in (tmp_path / "c", tmp_path / "c.csv" / "impossible"):
        with pytest.raises(UsageError):
            simulate_loop(*files, 0.1, out=out, record=tmp_path / "c.csv")
        assert list(tmp_path.glob("**/.*.part")) == []
    assert open_files() - before == Counter()


def open_files() -> Counter[str]:
    """Count what each descriptor of this process points at. A collected object of another test may close one."""
    links = []
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the one that lists the folder
            links.append(str(descriptor.readlink()))
    return Counter(links)


@pytest.mark.parametrize(("rpdo", "delay"), [("sync", 0), ("sync", 2), ("arrival", 0), ("arrival", 1)])
def test_a_command_acts_at_the_next_sync_or_on_arrival_or_whole_periods_later(
    tmp_path: Path, rpdo: str, delay: int
) -> None:
    tables = controller(
        setpoint={"kind": "step", "amplitude": 0.5, "at": 0.3, "rate": 10_000.0}, file={"bus": {"rpdo": rpdo}}
    )
    late = plant(motion={"kind": "still"}, drive={"delay_periods": delay})
    result = simulate_loop(*write(tmp_path, tables, late), 0.6)
    sent = result.log["t"][np.argmax(np.abs(result.log["tau_m_cmd"]) > 0.1)] + result.axes[0].start
    periods = delay + (rpdo == "sync")
    if periods:
        acted = result.truth["clock"][np.argmax(np.abs(result.truth["command"]) > 0.1)]
        assert 1e-3 * periods < acted - sent < 1e-3 * periods + 1e-4
    else:  # the current loop has had half a period
        after = result.truth["clock"] > sent + 0.9e-3
        assert abs(result.truth["tau_m"][np.argmax(after)]) > 0.1


@pytest.mark.parametrize(
    ("faults", "changes"),
    [(["fault@0.8"], ["setpoint_gain=0.9@0.5"]), ([Fault("fault", 0.8)], [Change("setpoint_gain", 0.9, 0.5)])],
    ids=["lines", "objects"],
)
def test_a_change_and_a_fault_begin_at_their_time_and_are_told(
    tmp_path: Path, faults: list[Any], changes: list[Any]
) -> None:
    tables = controller(setpoint={"kind": "constant", "offset": 0.5})
    result = simulate_loop(*write(tmp_path, tables), 1.0, faults=faults, changes=changes)
    t, wanted = result.log["t"], result.log["tau_j_des"]
    assert wanted[(t > 0.4) & (t < 0.5)] == pytest.approx(0.5)
    assert wanted[(t > 0.75) & (t < 0.8)] == pytest.approx(0.45)
    assert result.axes[0].faults[0].startswith("emergency: drive node 1")
    first = next(event for event in result.summary.events if event.fault)
    assert 0.8 <= first.t < 0.81


@pytest.mark.parametrize(
    ("line", "column", "factor"),
    [("pretension value=0.5", "pretension", 0.5), ("bending value=1.1", "theta", 1.1)],
)
def test_the_rig_may_change_while_it_runs(tmp_path: Path, line: str, column: str, factor: float) -> None:
    truth = simulate_loop(*write(tmp_path), 1.0, faults=[Fault(line, 0.8)]).truth
    assert truth[column][-1] / truth[column][0] == pytest.approx(factor)


@pytest.mark.parametrize(
    ("option", "text", "found"),
    [
        ("--seconds", "nan", "nan is not a finite number"),
        ("--set", "compensation=0.5", "is not NAME=VALUE@T"),
        ("--set", "compensation@2", "is not NAME=VALUE@T"),
        ("--set", "compensation=nan@2", "is not NAME=VALUE@T"),
        ("--set", "speed=1@0.5", "no parameter 'speed'"),
        ("--set", "compensation=7@0.5", "compensation 7 is out of bounds; allowed is 0 to 1.2"),
        ("--set", "hip.slew=7@0.5", "no axis 'hip'"),
        ("--fault", "torn_tendon", "is not LINE@T"),
        ("--fault", "torn_tendon@-1", "is not LINE@T"),
        ("--fault", "torn@1", "unknown fault 'torn'"),
        ("--fault", "torn_tendon@5", "--fault at 5 s: allowed are times up to the end of the run, 1 s"),
    ],
)
def test_a_wrong_option_is_one_line(
    option: str, text: str, found: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    controller_file, plant_file = write(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["simulate-loop", str(controller_file), str(plant_file), "--seconds", "1", option, text])
    assert ended.value.code == 2
    out, err = capsys.readouterr()
    assert found in err
    assert err.count("\n") == 1
    assert out == ""


@pytest.mark.slow
def test_an_interface_that_goes_down_latches_and_a_recovery_brings_all_up_anew(tmp_path: Path) -> None:
    """Frames on the bus are lost. The torque returns only after a request."""
    result = simulate_loop(*write(tmp_path), 5.0, faults=["interface_down duration=0.3@1"], changes=["recover=1@2"])
    assert result.axes[0].faults[0].startswith("bus fault: the interface is down")
    t, enabled = result.truth["clock"] - result.axes[0].start, result.truth["enabled"] > 0.0
    assert enabled[(t > 0.5) & (t < 0.99)].all()
    assert not enabled[(t > 1.3) & (t < 2.0)].any()
    assert enabled[(t > 4.0) & (t < 5.0)].all()


def test_nothing_of_a_flood_is_believed(tmp_path: Path) -> None:
    result = simulate_loop(*write(tmp_path), 1.0, faults=["flood value=3000@0.5"])
    assert not result.summary.failed
    assert result.summary.missed_pdo == 0  # identifiers of low priority are sent after the answers


def test_the_verb_prints_its_json_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    controller_file, plant_file = write(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["simulate-loop", str(controller_file), str(plant_file), "--seconds", "0.6", "--json"])
    assert ended.value.code == 0
    data = json.loads(capsys.readouterr().out)
    (axis,) = data["axes"]
    assert axis["name"] == "knee"
    assert axis["unit"] == "N*m"
    assert axis["state"] == "operation_enabled"
    assert 0.0 < axis["rms"] <= axis["peak"]
    assert axis["limit_reasons"]["NONE"] > 500


@pytest.mark.parametrize(("column", "source", "axis"), [("tau_j", SENSOR, {}), ("tau_j_stretch", ELONGATION, BLIND)])
def test_the_summary_has_the_torque_error_of_the_log(
    tmp_path: Path, column: str, source: str, axis: dict[str, Any]
) -> None:
    """The error is measured by the torque sensor or the elongation, from the end of the fade-in until the stop."""
    result = play(tmp_path, "weight", sine(0.5, 0.5), 3.0, axis=axis)
    log, found = result.axes[0].log, result.summary.torque[0]
    counted = result.axes[0].counted
    error = (log[column] - log["tau_j_des"])[counted]
    assert found.source == source
    assert found.seconds == pytest.approx(counted.sum() * 1e-3, abs=0.005)
    assert found.rms == pytest.approx(np.sqrt(np.nanmean(error**2)), rel=0.02)
    assert found.peak == pytest.approx(np.nanmax(np.abs(error)), rel=0.02)
    share = np.mean(log["limit_reason"][counted] == Reason.UNPROVEN.value)
    assert found.limited.get("UNPROVEN", 0.0) == pytest.approx(share, abs=0.01)
