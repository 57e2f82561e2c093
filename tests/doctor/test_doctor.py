"""Test that `tsa doctor` finds problems of a machine or a bus and prints the command that corrects each."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings
from tsa_ctrl.cli import main
from tsa_ctrl.doctor import can_interface, machine
from tsa_ctrl.doctor.can_interface import Check, Result, judge
from tsa_ctrl.system.realtime import RealtimeSettings

CONFIG = Path(__file__).parents[2] / "config" / "controller.toml"


def by_name(checks: list[Check], name: str) -> Check:
    return next(check for check in checks if check.name == name)


def test_a_good_finding_needs_no_fix() -> None:
    assert judge("x", True, "1", "1", "mend it") == Check("x", Result.PASS, "1", "1")


def test_a_bad_finding_names_its_fix() -> None:
    assert judge("x", False, "2", "1", "mend it", Result.FAIL) == Check("x", Result.FAIL, "2", "1", "mend it")


def test_lateness_is_measured_with_the_asked_number_of_cycles() -> None:
    checks = list(machine.checks(RealtimeSettings(allow_without=True), 200.0, 0.25))
    assert "in 50 cycles at 200 Hz" in by_name(checks, "lateness").found


def test_rights_are_read_back_not_assumed() -> None:
    checks = list(machine.checks(RealtimeSettings(priority=7), 200.0, 0.05))
    scheduling = by_name(checks, "scheduling")
    assert (scheduling.result is Result.PASS) == (scheduling.found == "SCHED_FIFO 7")


def test_a_slow_clock_source_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "current_clocksource").write_text("hpet\n")
    (tmp_path / "available_clocksource").write_text("hpet tsc acpi_pm\n")
    monkeypatch.setattr(machine, "CLOCKS", tmp_path)
    check = machine.clock_source()
    assert check.result is Result.WARN
    assert check.fix.startswith("echo tsc > ")


def test_a_saving_governor_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "cpu0" / "cpufreq"
    folder.mkdir(parents=True)
    (folder / "scaling_governor").write_text("powersave\n")
    monkeypatch.setattr(machine, "CPUS", tmp_path)
    assert machine.governor().found == "powersave"
    assert machine.governor().result is Result.WARN


def test_a_missing_interface_fails_with_the_command_that_makes_it() -> None:
    settings = BusSettings(channel="can97")
    checks = list(can_interface.checks(settings, [], 1000.0))
    check = by_name(checks, "CAN interface")
    assert check.result is Result.FAIL
    assert "ip link set can97 type can bitrate 1000000" in check.fix
    assert by_name(checks, "bus").result is Result.FAIL


def test_a_rate_that_the_bit_rate_cannot_carry_fails_with_the_highest_that_it_can() -> None:
    axes = [AxisNodes(name="a", drive=DriveSettings(node_id=1))]
    settings = BusSettings(interface="virtual", channel="doctor", bitrate=125_000)
    check = by_name(list(can_interface.checks(settings, axes, 1000.0)), "bus load")
    assert check.result is Result.FAIL
    assert "rate at most" in check.fix


def test_a_silent_drive_fails() -> None:
    axes = [AxisNodes(name="a", drive=DriveSettings(node_id=5))]
    checks = list(can_interface.checks(BusSettings(interface="virtual", channel="doctor"), axes, 100.0))
    assert by_name(checks, "round trip to node 5").found == "no answer"


def test_json_is_one_object_and_the_exit_code_tells_of_a_failure(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["doctor", "--json", "--seconds", "0.1"])
    data = json.loads(capsys.readouterr().out)
    assert data["schema"] == 1
    assert stop.value.code == int(any(check["result"] == "fail" for check in data["checks"]))
    assert {tuple(check) for check in data["checks"]} == {("name", "result", "found", "wanted", "fix")}


def test_a_missing_configuration_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["doctor", "nowhere.toml"])
    assert stop.value.code == 2
    assert capsys.readouterr().out == ""


@pytest.mark.vcan
def test_a_vcan_that_is_up_passes() -> None:
    vcan = os.environ["TSA_VCAN"]
    checks = list(can_interface.checks(BusSettings(channel=vcan), [], 1000.0))
    assert by_name(checks, "CAN interface").result is Result.PASS
    assert by_name(checks, "bit rate").result is Result.PASS
