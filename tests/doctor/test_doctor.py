"""Test that `tsa doctor` finds problems of a machine or a bus and prints the command that corrects each."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from tests.bus.fake import FakeBus
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings
from tsa_ctrl.bus.wire.bus import Frame
from tsa_ctrl.cli import main
from tsa_ctrl.cli.doctor import serial_numbers
from tsa_ctrl.doctor import can_interface, machine
from tsa_ctrl.doctor.can_interface import Check, Result
from tsa_ctrl.system.realtime import RealtimeSettings

CONFIG = Path(__file__).parents[2] / "config" / "controller.toml"


def by_name(checks: list[Check], name: str) -> Check:
    return next(check for check in checks if check.name == name)


def test_lateness_is_measured_and_rights_are_read_back_not_assumed() -> None:
    checks = list(machine.checks(RealtimeSettings(priority=7, allow_without=True), 200.0, 0.25))
    assert "in 50 cycles at 200 Hz" in by_name(checks, "lateness").found
    scheduling = by_name(checks, "scheduling")
    assert (scheduling.result is Result.PASS) == (scheduling.found == "SCHED_FIFO 7")


def test_a_slow_clock_source_and_a_saving_governor_are_warnings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "current_clocksource").write_text("hpet\n")
    (tmp_path / "available_clocksource").write_text("hpet tsc acpi_pm\n")
    monkeypatch.setattr(machine, "CLOCKS", tmp_path)
    check = machine.clock_source()
    assert check.result is Result.WARN
    assert check.fix.startswith("echo tsc > ")
    folder = tmp_path / "cpu0" / "cpufreq"
    folder.mkdir(parents=True)
    (folder / "scaling_governor").write_text("powersave\n")
    monkeypatch.setattr(machine, "CPUS", tmp_path)
    assert (machine.governor().found, machine.governor().result) == ("powersave", Result.WARN)


def test_a_missing_interface_fails_with_the_command_that_makes_it() -> None:
    settings = BusSettings(channel="can97")
    checks = list(can_interface.checks(settings, [], 1000.0))
    check = by_name(checks, "CAN interface")
    assert check.result is Result.FAIL
    assert "ip link set can97 type can bitrate 1000000" in check.fix
    assert by_name(checks, "bus").result is Result.FAIL


def test_a_rate_that_the_bit_rate_cannot_carry_and_a_silent_drive_fail() -> None:
    axes = [AxisNodes(name="a", drive=DriveSettings(node_id=5))]
    settings = BusSettings(interface="virtual", channel="doctor", bitrate=125_000)
    checks = list(can_interface.checks(settings, axes, 1000.0))
    load = by_name(checks, "bus load")
    assert load.result is Result.FAIL
    assert "rate at most" in load.fix
    assert by_name(checks, "round trip to node 5").found == "no answer"


def test_json_is_one_object_and_the_exit_code_tells_of_a_failure(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["doctor", "--json", "--seconds", "0.1"])
    data = json.loads(capsys.readouterr().out)
    assert data["schema"] == 1
    assert stop.value.code == int(any(check["result"] == "fail" for check in data["checks"]))
    assert {tuple(check) for check in data["checks"]} == {("name", "result", "found", "wanted", "fix")}
    assert all(bool(check["fix"]) == (check["result"] != "pass") for check in data["checks"])
    with pytest.raises(SystemExit) as stop:
        main(["doctor", "nowhere.toml"])
    assert (stop.value.code, capsys.readouterr().out) == (2, "")


@pytest.mark.vcan
def test_a_vcan_that_is_up_passes() -> None:
    vcan = os.environ["TSA_VCAN"]
    checks = list(can_interface.checks(BusSettings(channel=vcan), [], 1000.0))
    assert by_name(checks, "CAN interface").result is Result.PASS


def _segments(toggle: int) -> Callable[[bytes], bytes | None]:
    """Return a server that announces four bytes in segments, and sends the first one with this toggle bit."""
    return lambda request: (
        struct.pack("<B3sI", 0x41, request[1:4], 4)
        if request[0] == 0x40
        else bytes([0x07 | toggle]) + b"\x2a" + bytes(6)
    )


NO_NUMBER: dict[str, Callable[[bytes], bytes | None]] = {
    "abort code 0x06020000": lambda request: struct.pack("<B3sI", 0x80, request[1:4], 0x06020000),
    "does not answer SDO requests": lambda request: None,
    "Toggle bit mismatch": _segments(0x10),
    "Unexpected response 0xC0": lambda request: b"\xc0" + request[1:],
    "instead": lambda request: b"\x43\x00\x10\x00" + bytes(4),
    "has 0 in 0x1018:4": lambda request: b"\x43" + request[1:4] + bytes(4),
}


def test_a_drive_without_a_readable_serial_number_does_not_stop_the_others() -> None:
    """Every reason is printed with its node. The drives behind it are still read."""
    servers = [*NO_NUMBER.values(), _segments(0), lambda request: b"\x43" + request[1:4] + b"\x29\x00\x00\x00"]

    def answer(frame: Frame) -> Iterable[Frame]:
        node_id = frame[0] - 0x600
        data = servers[node_id - 1](frame[1]) if frame[1][0] != 0x80 else None
        return [] if data is None else [(0x580 + node_id, data)]

    axes = [AxisNodes(name=f"a{place}", drive=DriveSettings(node_id=place)) for place in range(1, len(servers) + 1)]
    found = serial_numbers(FakeBus(answer=answer), BusSettings(), axes, [DriveProfile()] * len(axes))
    *reasons, segmented, expedited = found.values()
    assert (segmented, expedited) == (42, 41)
    for place, (reason, text) in enumerate(zip(NO_NUMBER, reasons, strict=True), 1):
        assert isinstance(text, str)
        assert text.startswith("no serial number: ")
        assert f"node {place} " in text
        assert reason in text
        assert "\n" not in text
